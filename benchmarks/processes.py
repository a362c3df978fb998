"""Processes that the benchmarks start, gone afterwards with all that they have started themselves.

    python -S benchmarks/processes.py MARK    # the guard; not to be started by hand

Peers leave processes behind when they are cut off, some in sessions of their own. So whatever is
started here has a mark in its environment, which its descendants inherit: they are found in /proc,
together with the descendants and the session of the process itself, and killed until none is left.
If the benchmark itself is cut off, however that happens, its guard does the same: a process that
waits for the end of a pipe that only the benchmark holds.
"""

import atexit
import contextlib
import itertools
import os
import secrets
import signal
import subprocess
import sys
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from dppo.machine import THREAD_VARIABLES

ROOT = Path(__file__).parents[1]
ONE_THREAD = dict.fromkeys(THREAD_VARIABLES, "1")
"""Environment of processes that are given one core each."""
_MARK = "DPPO_BENCHMARK"
_OUTER = os.environ.get(_MARK, "")
"""The mark of this process, if a benchmark has started it."""
_OWN = f"{_OUTER}{secrets.token_hex(8)}/"
_NUMBERS = itertools.count()
_DEADLINE = 20.0
"""For processes to disappear once they are killed [s]."""


class SkippedError(Exception):
    """The case cannot be measured here: a sentence that says why."""


class Entry(NamedTuple):
    """A living process; pid and `since` together name it for ever."""

    pid: int
    parent: int
    session: int
    since: int


@dataclass(frozen=True)
class Tree:
    """A process and all that it has started; a context manager that ends them."""

    process: subprocess.Popen[str]
    mark: str
    since: int
    """When it started: what tells it from a later process with the same number."""

    def __enter__(self) -> "Tree":
        return self

    def __exit__(self, *_: object) -> None:
        self.end()

    def end(self, patience: float = 0.0) -> None:
        """Ask the process, if there is patience [s]; then kill all that is left, for certain."""
        root = self.process.pid, self.since
        known = members(self.mark, root)  # before a parent ends and its trace is lost
        try:
            if patience:
                self.process.send_signal(signal.SIGTERM)
                with contextlib.suppress(subprocess.TimeoutExpired):
                    self.process.wait(patience)
        finally:
            _kill(self.mark, root, known)
            self.process.wait()


def started(
    words: Sequence[str],
    environment: Mapping[str, str],
    **options: Any,  # noqa: ANN401  of Popen
) -> Tree:
    """A process in this checkout.

    Raises:
        SkippedError: there is no such program.
    """
    if not _OUTER:
        _guard()
    mark = f"{_OWN}{next(_NUMBERS)}/"
    env = os.environ | environment | {"PYTHONPATH": str(ROOT), _MARK: mark}
    try:
        process = subprocess.Popen(words, cwd=ROOT, env=env, text=True, **options)
    except OSError as error:
        raise SkippedError(f"{words[0]} cannot be started: {error}") from error
    entry = _table().get(process.pid)
    return Tree(process, mark, entry.since if entry else 0)


@cache
def _guard() -> None:
    """Ends all that has been started here when this process is gone, or about to be."""
    words = [sys.executable, "-S", "-P", __file__, _OWN]
    env = os.environ | {"PYTHONPATH": str(ROOT)}
    guard = subprocess.Popen(words, stdin=subprocess.PIPE, env=env, start_new_session=True)
    atexit.register(guard.communicate)  # closes its pipe, and waits for it


def family(pid: int) -> list[int]:
    """A process and its living descendants."""
    table = _table()
    found = [pid]
    for member in found:  # grows while it is walked
        found += [entry.pid for entry in table.values() if entry.parent == member]
    return found


def members(mark: str, root: tuple[int, int] = (0, 0)) -> set[Entry]:
    """Living processes with the mark, descendants of these, sessions that one of them leads.

    Args:
        mark: as in `Tree`; a part in front of it names more processes.
        root: number and start of a process that belongs to them whatever /proc says of it.
    """
    table, (number, since) = _table(), root
    found = {pid for pid in table if _is_marked(pid, mark)}
    if number not in table or table[number].since == since:
        found.add(number)
    size = 0
    while len(found) > size:
        size = len(found)
        found |= {
            entry.pid for entry in table.values() if {entry.parent, entry.session} & found - {0}
        }
    return {table[pid] for pid in found & table.keys() - {os.getpid()}}


def _is_marked(pid: int, mark: str) -> bool:
    try:
        return f"{_MARK}={mark}".encode() in Path(f"/proc/{pid}/environ").read_bytes()
    except OSError:  # gone, or somebody else's
        return False


def _table() -> dict[int, Entry]:
    """All living processes."""
    table = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = stat.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if fields[0] not in "ZX":
            parent, session, since = int(fields[1]), int(fields[3]), int(fields[19])
            table[int(stat.parent.name)] = Entry(int(stat.parent.name), parent, session, since)
    return table


def _kill(mark: str, root: tuple[int, int] = (0, 0), known: Iterable[Entry] = ()) -> None:
    """Kill until none is left, those included that are started meanwhile.

    Raises:
        TimeoutError: some do not disappear.
    """
    names, until = {(entry.pid, entry.since) for entry in known}, time.monotonic() + _DEADLINE
    while True:
        names |= {(entry.pid, entry.since) for entry in members(mark, root)}
        table = _table()
        left = [pid for pid, since in names if pid in table and table[pid].since == since]
        if not left:
            return
        if time.monotonic() > until:
            raise TimeoutError(f"processes {left} are still there {_DEADLINE:g} s after SIGKILL")
        for pid in left:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        time.sleep(0.01)


if __name__ == "__main__":
    sys.stdin.buffer.read()  # until the benchmark is gone
    _kill(sys.argv[1])
