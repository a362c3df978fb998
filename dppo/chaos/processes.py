"""Processes of a drill: started, found again, looked at in /proc, ended.

Everything that a drill starts, and what that starts, carries a mark in its environment; so nothing
of it hides, whatever session or parent it has by then.
"""

import contextlib
import os
import signal
import subprocess
import time
from dataclasses import dataclass
from pathlib import Path

from dppo.machine import own_program

MARK = "DPPO_DRILL"
_PAGE = os.sysconf("SC_PAGE_SIZE")


@dataclass(frozen=True, slots=True)
class Handle:
    """One process; never another one that got its number later."""

    pid: int
    born: int
    """When it started, in the kernel's ticks."""

    @classmethod
    def of(cls, pid: int) -> "Handle | None":
        """The process of that number; None: it has ended."""
        fields = _stat(pid)
        return None if fields is None or fields[0] == "Z" else cls(pid, int(fields[19]))

    @property
    def alive(self) -> bool:
        """It still runs, or is stopped."""
        return Handle.of(self.pid) == self

    def send(self, number: signal.Signals) -> None:
        """A signal; nothing happens if it has ended."""
        if self.alive:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self.pid, number)


@dataclass(frozen=True, slots=True)
class Usage:
    """What a process has of the machine's at one moment."""

    rss: int
    """Resident memory [bytes]."""
    fds: int
    threads: int

    @classmethod
    def of(cls, pid: int) -> "Usage | None":
        """Of a process; None: it has ended."""
        fields = _stat(pid)
        try:
            fds = len(os.listdir(f"/proc/{pid}/fd"))  # noqa: PTH208  names are enough
        except OSError:
            return None
        if fields is None or fields[0] == "Z":
            return None
        return cls(rss=int(fields[21]) * _PAGE, fds=fds, threads=int(fields[17]))


@dataclass(slots=True)
class Child:
    """A process that the drill has started, its output in a file."""

    name: str
    popen: subprocess.Popen[bytes]
    output: Path

    @classmethod
    def start(cls, name: str, words: list[str], folder: Path, mark: str) -> "Child":
        """`python -m words...`, in a session of its own: Ctrl-C is for the drill alone."""
        output = folder / f"{name}.txt"
        with output.open("ab") as file:
            popen = subprocess.Popen(
                own_program(*words),
                stdin=subprocess.DEVNULL,
                stdout=file,
                stderr=subprocess.STDOUT,
                env=os.environ | {MARK: mark},
                start_new_session=True,
            )
        return cls(name, popen, output)

    @property
    def pid(self) -> int:
        """Its number."""
        return self.popen.pid

    @property
    def running(self) -> bool:
        """It has not ended, though it may be stopped."""
        return self.popen.poll() is None

    def last_words(self, lines: int = 5) -> str:
        """The end of its output."""
        return "\n".join(self.output.read_text(errors="replace").splitlines()[-lines:])

    def complaint(self) -> str:
        """The error that it ended with, in one line."""
        said = self.output.read_text(errors="replace")
        _, known, error = said.rpartition("error: ")
        words = (error if known else said).split()
        return " ".join(word for word in words if word.strip("╭╮╰╯│─"))


def children_of(pid: int) -> list[Handle]:
    """Living child processes, oldest first."""
    found = [
        Handle(int(entry.name), int(fields[19]))
        for entry in Path("/proc").glob("[0-9]*")
        if (fields := _stat(int(entry.name))) is not None
        and int(fields[1]) == pid
        and fields[0] != "Z"
    ]
    return sorted(found, key=lambda child: (child.born, child.pid))


def marked(mark: str) -> list[Handle]:
    """Every living process that carries the mark, but not this one."""
    wanted, found = f"{MARK}={mark}".encode(), []
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            environment = (entry / "environ").read_bytes()
        except OSError:
            continue  # another user's, or ended meanwhile
        handle = Handle.of(int(entry.name))
        if handle and handle.pid != os.getpid() and wanted in environment.split(b"\0"):
            found.append(handle)
    return found


def shared_memory_of(pid: int) -> set[Path]:
    """Files in /dev/shm that a process has open or mapped."""
    found = set()
    with contextlib.suppress(OSError):
        for line in Path(f"/proc/{pid}/maps").read_text().splitlines():
            name = line.partition("/dev/shm/")[2]
            if name:
                found.add(Path("/dev/shm") / name.removesuffix(" (deleted)"))
    return found


def listeners(port: int) -> int:
    """Sockets that listen on a port of this machine."""
    found = 0
    for table in ("/proc/net/tcp", "/proc/net/tcp6"):
        with contextlib.suppress(OSError):
            rows = [line.split() for line in Path(table).read_text().splitlines()[1:]]
            found += sum(row[1].endswith(f":{port:04X}") and row[3] == "0A" for row in rows)
    return found


def wait_for_end(handles: list[Handle], seconds: float) -> list[Handle]:
    """Wait until all have ended, but no longer than that; those that have not."""
    until = time.monotonic() + seconds
    while (left := [handle for handle in handles if handle.alive]) and time.monotonic() < until:
        time.sleep(0.02)
    return left


def _stat(pid: int) -> list[str] | None:
    """Fields of /proc/<pid>/stat from the state on; None: no such process."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return None
