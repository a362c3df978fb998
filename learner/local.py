"""Worker processes on the learner's own machine: started, looked after, ended."""

import contextlib
import logging
import math
import signal
import subprocess
import time
from dataclasses import dataclass, field

from dppo.errors import RunFailedError
from dppo.machine import free_port, own_program, usable_cores
from dppo.wire.socket_links import SocketLearnerLink

log = logging.getLogger("learner")
_TROUBLE_SECONDS = 5.0
"""A worker that dies younger than this counts as one that cannot start."""
_MOST_FAILED_STARTS = 2
"""With none that lived longer between them, the last by an exit code."""
_MOST_YOUNG_DEATHS = 20
"""The same, by a signal: somebody may be killing them on purpose."""
_HINTS = {
    -signal.SIGKILL: " (SIGKILL: from somebody, or from the system for want of memory)",
    -signal.SIGSEGV: " (SIGSEGV: its environment touched memory that is not its own)",
}
_END_SECONDS = 3.0
_END_LOOK_SECONDS = 0.02
_LOOK_SECONDS = 0.2
_AGAIN_SECONDS = 5.0
"""Until the next attempt, where the machine has no room for a process."""


def free_address() -> str:
    """A loopback address with a port that was free a moment ago."""
    return f"tcp/127.0.0.1:{free_port()}"


@dataclass(slots=True)
class _Child:
    name: str
    process: subprocess.Popen[bytes]
    born: float
    silent: float = 0.0
    """Since it was last heard, as long as this process listened [s]."""


@dataclass(slots=True)
class LocalWorkers:
    """`count` worker processes, each on a pair of sockets with this one. They die with it.

    However this process ends, kill -9 included, the system ends them, too; where it cannot, they
    see their socket's other end gone and exit.
    """

    link: SocketLearnerLink
    count: int
    verbose: bool
    most_silent: float = math.inf
    """One of which nothing was heard for so long is replaced: it may hang before it joins [s]."""
    _children: dict[int, _Child | None] = field(default_factory=dict)
    """None: there is no room for it now."""
    _young_deaths: int = 0
    _spawned: int = 0
    _looked: float = 0.0
    _look_again: float = 0.0

    def start(self) -> None:
        """Start all of them."""
        for index in range(self.count):
            self._children[index] = self._spawn(index, 0)

    def look_after(self) -> None:
        """Start again what has died, and what the run has given up.

        Raises:
            RunFailedError: they die as soon as they start, again and again.
        """
        now = time.monotonic()
        if now < self._look_again:
            return  # asked in every round, which may be a thousand times a second
        self._look_again = now + _LOOK_SECONDS
        passed, self._looked = min(now - self._looked, 2 * _LOOK_SECONDS), now
        for index, child in self._children.items():
            if child is not None:
                if self._is_well(index, child, passed):
                    continue
                self.link.forget(child.name)
                self._children[index] = None
            self._spawned += 1
            try:
                self._children[index] = self._spawn(index, self._spawned)
            except OSError as error:
                self._look_again = now + _AGAIN_SECONDS
                log.warning(
                    "local worker %d cannot be started: %s; it is tried again every %g s",
                    index, error, _AGAIN_SECONDS,
                )  # fmt: skip

    def _is_well(self, index: int, child: _Child, passed: float) -> bool:
        """Does it live, and was it heard? One that cannot end by itself is ended."""
        child.silent = 0.0 if self.link.has_spoken(child.name) else child.silent + passed
        if (died := child.process.poll()) is not None:
            self._count_death(index, child, died)
            return False
        why = "was given up" if self.link.was_cut(child.name) else ""
        if child.silent > self.most_silent:
            why = f"has said nothing for {child.silent:.0f} s"
        if why:
            log.warning("local worker %d %s; starting another in its place", index, why)
            _kill(child.process)
        elif time.monotonic() - child.born > _TROUBLE_SECONDS:
            self._young_deaths = 0
        return not why

    def _count_death(self, index: int, child: "_Child", code: int) -> None:
        what = f"{code}{_HINTS.get(code, '')}"
        log.warning("local worker %d died with exit code %s; starting another", index, what)
        if time.monotonic() - child.born > _TROUBLE_SECONDS:
            return
        self._young_deaths += 1
        if self._young_deaths > (_MOST_YOUNG_DEATHS if code < 0 else _MOST_FAILED_STARTS):
            raise RunFailedError(
                f"local workers died {self._young_deaths} times within {_TROUBLE_SECONDS:g} s of "
                f"their start and none lived longer, the last with exit code {code}; see what "
                "they printed above"
            )

    def end(self) -> None:
        """End all of them, within three seconds."""
        until = time.monotonic() + _END_SECONDS
        self.link.let_go()
        processes = [child.process for child in self._children.values() if child is not None]
        while time.monotonic() < until and any(process.poll() is None for process in processes):
            time.sleep(_END_LOOK_SECONDS)
        for process in processes:
            _kill(process)  # those that have ended are left alone
        self._children.clear()

    def _spawn(self, index: int, restart: int) -> _Child:
        name = f"local-{index}" + (f"-{restart}" if restart else "")
        inherited = self.link.adopt(name)
        try:
            process = subprocess.Popen(
                self._command(name, self._core(index), *map(str, inherited.descriptors)),
                stdin=subprocess.DEVNULL,
                pass_fds=inherited.descriptors,
                start_new_session=True,
            )
        except OSError:
            self.link.forget(name)
            raise
        finally:
            inherited.close()
        return _Child(name, process, time.monotonic())

    def _core(self, index: int) -> int:
        """Each has a core of its own where there are as many as cores; else -1."""
        return index if 1 < self.count == usable_cores() else -1

    def _command(self, name: str, core: int, *descriptors: str) -> list[str]:
        verbose = "--verbose" if self.verbose else "--no-verbose"
        words = ("--name", name, "--core", str(core), verbose)
        return own_program("workers", "--socket", *descriptors, *words)


def _kill(process: subprocess.Popen[bytes]) -> None:
    """End a process that may be unable to, and take note of its end unless the kernel holds it."""
    process.kill()
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(_END_LOOK_SECONDS)
