"""What all commands share: command line, log lines, signals, exit codes."""

import contextlib
import io
import logging
import math
import os
import select
import signal
import sys
import time
import traceback
from collections.abc import Callable
from types import FrameType
from typing import NoReturn, TextIO, TypeVar

from dppo.errors import DppoError, UsageError
from dppo.signals import heeded

Args = TypeVar("Args")
_SWITCH_SECONDS = 1e-4
"""A thread that has waited this long for the interpreter gets it.

NumPy hands the interpreter back within microseconds when it steps a small environment, and each
time the thread that waits starts to wait anew: with Python's 5 ms it never ran, no sign of life
was sent and no end of a parent was seen. It costs nothing while no other thread has work.
"""
_TIDY_SECONDS = 10.0
"""A command that has been told to end has so long before a further signal ends it at once."""
_LINE_SECONDS = 1.0
"""Longest wait for somebody to take a line."""
_AGAIN_SECONDS = 0.05
"""A signal that comes during an import is looked at again after so long."""
_IMPORT_SECONDS = 5.0
"""An import that lasts so much longer is interrupted."""


class Terminated(BaseException):
    """SIGTERM arrived."""


def parse(kind: type[Args], argv: list[str], program: str, default: Args | None = None) -> Args:
    """The arguments, or exit code 2 with what is wrong and the nearest flags; or the versions.

    Raises:
        SystemExit: --version, --help or a wrong argument has been answered.
        UsageError: a value that cannot be, where tyro before 1.0.16 leaves it to us to say so.
    """
    if argv[:1] == ["--version"]:
        from dppo.sources import version_line

        say(version_line())
        raise SystemExit(0)
    import tyro

    config = (tyro.conf.OmitArgPrefixes,)
    try:
        if default is None:
            return tyro.cli(kind, args=argv, prog=program, config=config)
        return tyro.cli(kind, args=argv, prog=program, config=config, default=default)
    except ValueError as error:
        raise UsageError(str(error)) from error


def start_logging(verbose: bool) -> None:
    """Log lines to stderr: time, who, what."""
    logging.basicConfig(
        level=logging.INFO if verbose else logging.WARNING,
        format="%(asctime)s %(name)s: %(message)s",
        datefmt="%H:%M:%S",
        stream=sys.stderr,
    )


class _Ending:
    """The end of a process: the first signal begins it, a later one may cut it short."""

    def __init__(self) -> None:
        self._begun = math.inf
        self._put_off, self._most = 0, math.inf
        """The signal that has come while something was imported, and until when that counts."""

    def listen(self) -> None:
        """Take over the signals that ask for an end."""
        signal.signal(signal.SIGALRM, self._again)
        for number in heeded():
            signal.signal(number, self.arrived)

    def begin(self) -> None:
        """From here on signals end nothing, for a while."""
        self._begun = min(self._begun, time.monotonic())

    def arrived(self, number: int, frame: FrameType | None) -> None:
        """A signal: raises the first time; at once out when tidying up takes too long.

        Not within an import, unless it takes long: some libraries swallow there what is raised.
        """
        if time.monotonic() - self._begun > _TIDY_SECONDS:
            os._exit(128 + number)
        if self._begun < math.inf:
            return
        self._most = min(self._most, time.monotonic() + _IMPORT_SECONDS)
        if _imports(frame) and time.monotonic() < self._most:
            self._put_off = number
            signal.setitimer(signal.ITIMER_REAL, _AGAIN_SECONDS)
            return
        self.begin()
        raise KeyboardInterrupt if number == signal.SIGINT else Terminated

    def _again(self, _number: int, frame: FrameType | None) -> None:
        self.arrived(self._put_off, frame)


def _imports(frame: FrameType | None) -> bool:
    """Is a module being imported?"""
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            return True
        frame = frame.f_back
    return False


def leave(work: Callable[[], int], delivers: bool = False) -> NoReturn:
    """Run `work` and end the process with its exit code, without waiting for any thread.

    The first Ctrl-C or SIGTERM ends it. Later ones change nothing for a while: they would cut
    short what tidies up, and leave processes behind.

    Args:
        work: its exit code is the process's.
        delivers: after a signal the result is missing: exit code 128 + signal, and a line. Else
            it is 0: what was reached is kept, or nobody waits for anything.
    """
    code = _exit_code(_Ending(), work, delivers)
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError):  # a pipe that nobody reads, a file on a full disk
            if delivers or _takes(stream):
                stream.flush()
    os._exit(code)


def _exit_code(ending: _Ending, work: Callable[[], int], delivers: bool) -> int:
    try:
        ending.listen()
        _prepare()
        code = work()
        ending.begin()
        return code
    except (KeyboardInterrupt, Terminated) as stop:
        if not delivers:
            return 0
        number = signal.SIGINT if isinstance(stop, KeyboardInterrupt) else signal.SIGTERM
        say(f"stopped by {number.name}; the result is not complete", sys.stderr)
        return 128 + number
    except Exception as error:
        ending.begin()
        return _failed(error)


def _failed(error: Exception) -> int:
    """Say why; the exit code."""
    match error:
        case BrokenPipeError():
            return 0  # whoever reads has enough
        case DppoError() | OSError():
            say(f"error: {error}", sys.stderr)
            return 2 if isinstance(error, UsageError) else 1
    traceback.print_exception(error)  # a bug of ours
    return 1


def _prepare() -> None:
    sys.setswitchinterval(_SWITCH_SECONDS)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # it may know neither σ nor ψ
            stream.reconfigure(errors="replace")


def clock(seconds: float) -> str:
    """`12:05:09`."""
    minutes, rest = divmod(int(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}"


def say(text: str, stream: TextIO | None = None) -> None:
    """One line, to stdout unless told otherwise, if anybody takes it.

    A full disk, a closed pipe, or a terminal that has been stopped costs the line, not the run.
    """
    with contextlib.suppress(OSError):
        if _takes(stream or sys.stdout):
            print(text, file=stream, flush=True)


def _takes(stream: TextIO) -> bool:
    """Would a line be taken, within a moment?"""
    try:
        return bool(select.select([], [stream], [], _LINE_SECONDS)[1])
    except (OSError, TypeError, ValueError):  # nothing that can be asked
        return True
