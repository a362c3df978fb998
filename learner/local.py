"""Worker processes on the learner's own machine: started, looked after, ended."""

import contextlib
import logging
import socket
import subprocess
import sys
import time
from dataclasses import dataclass, field

from dppo.errors import RunFailedError
from dppo.wire.socket_links import SocketLearnerLink

log = logging.getLogger("learner")
_TROUBLE_SECONDS = 5.0
"""A worker that dies younger than this counts as one that cannot start."""
_MOST_FAILED_STARTS = 2
"""With none that lived longer between them, the last by an exit code."""
_MOST_YOUNG_DEATHS = 20
"""The same, by a signal: somebody may be killing them on purpose."""
_END_SECONDS = 3.0
_END_LOOK_SECONDS = 0.02
_LOOK_SECONDS = 0.2


def free_address() -> str:
    """A loopback address with a port that was free a moment ago."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


@dataclass(slots=True)
class _Child:
    name: str
    process: subprocess.Popen[bytes]
    born: float


@dataclass(slots=True)
class LocalWorkers:
    """`count` worker processes, each on a pair of sockets with this one. They die with it.

    However this process ends, kill -9 included, they see their socket's other end gone and exit;
    one that is stopped just then does so when it is continued.
    """

    link: SocketLearnerLink
    count: int
    verbose: bool
    _children: dict[int, _Child] = field(default_factory=dict)
    _young_deaths: int = 0
    _spawned: int = 0
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
        for index, child in self._children.items():
            died = child.process.poll()
            if self.link.was_cut(child.name):  # it may be unable to end by itself
                log.warning("local worker %d was given up; starting another in its place", index)
                _kill(child.process)
            elif died is not None:
                self._count_death(index, child, died)
            else:
                if time.monotonic() - child.born > _TROUBLE_SECONDS:
                    self._young_deaths = 0
                continue
            self.link.forget(child.name)
            self._spawned += 1
            self._children[index] = self._spawn(index, self._spawned)

    def _count_death(self, index: int, child: "_Child", code: int) -> None:
        log.warning("local worker %d died with exit code %d; starting another", index, code)
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
        processes = [child.process for child in self._children.values()]
        while time.monotonic() < until and any(process.poll() is None for process in processes):
            time.sleep(_END_LOOK_SECONDS)
        for process in processes:
            _kill(process)  # those that have ended are left alone
        self._children.clear()

    def _spawn(self, index: int, restart: int) -> _Child:
        name = f"local-{index}" + (f"-{restart}" if restart else "")
        inherited = self.link.adopt(name)
        command = [
            sys.executable,
            "-m",
            "workers",
            "--socket",
            *(str(descriptor) for descriptor in inherited.descriptors),
            "--name",
            name,
            "--verbose" if self.verbose else "--no-verbose",
        ]
        process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            pass_fds=inherited.descriptors,
            start_new_session=True,
        )
        inherited.close()
        return _Child(name, process, time.monotonic())


def _kill(process: subprocess.Popen[bytes]) -> None:
    """End a process that may be unable to, and take note of its end unless the kernel holds it."""
    process.kill()
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(_END_LOOK_SECONDS)
