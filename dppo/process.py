"""What all commands share: threads, command line, log lines, exit codes."""

import contextlib
import ctypes.util
import importlib.util
import logging
import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import NoReturn, TypeVar

from dppo.errors import DppoError, UsageError

Args = TypeVar("Args")
THREAD_VARIABLES = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
"""What numeric libraries read, once, when they are imported."""
_SWITCH_SECONDS = 1e-4
"""A thread that has waited this long for the interpreter gets it.

NumPy hands the interpreter back within microseconds when it steps a small environment, and each
time the thread that waits starts to wait anew: with Python's 5 ms it never ran, no sign of life
was sent and no end of a parent was seen. It costs nothing while no other thread has work.
"""


class Terminated(BaseException):
    """SIGTERM arrived."""


def one_thread() -> None:
    """One thread per process, before NumPy is imported: same shapes, same bits, no fighting."""
    for name in THREAD_VARIABLES:
        os.environ[name] = "1"


def no_window() -> None:
    """Nothing is drawn here: keep MuJoCo from opening a window system, before it is imported.

    Gymnasium imports pyGLFW all the same; told where its library is, it starts no process to look
    for it, which would complain when its parent ends first.
    """
    os.environ.setdefault("MUJOCO_GL", "disable")
    package = importlib.util.find_spec("glfw")
    if package is not None and package.origin is not None:
        library = Path(package.origin).parent / "x11" / "libglfw.so"
        if library.exists():
            os.environ.setdefault("PYGLFW_LIBRARY", str(library))


def draw_unseen() -> None:
    """Pictures without a window: keep MuJoCo off the screen, before it is imported.

    EGL and OSMesa draw into memory, with a GPU or in software. What the user has set stays.
    """
    for name, library in (("egl", "EGL"), ("osmesa", "OSMesa")):
        if ctypes.util.find_library(library) is not None:
            os.environ.setdefault("MUJOCO_GL", name)


def give_back_memory() -> None:
    """Return what was freed to the system, where the C library can (glibc).

    Environments are large and other things lie between them: without this a process that builds
    them anew, again and again, grows by some kilobytes per environment.
    """
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)


def usable_cores() -> int:
    """Cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def parse(kind: type[Args], argv: list[str], program: str, default: Args | None = None) -> Args:
    """The arguments, or exit code 2 with what is wrong and the nearest flags."""
    import tyro

    config = (tyro.conf.OmitArgPrefixes,)
    if default is None:
        return tyro.cli(kind, args=argv, prog=program, config=config)
    return tyro.cli(kind, args=argv, prog=program, config=config, default=default)


def start_logging(verbose: bool) -> None:
    """Log lines to stderr: time, who, what."""
    logging.basicConfig(
        level=logging.INFO if verbose else logging.WARNING,
        format="%(asctime)s %(name)s: %(message)s",
        datefmt="%H:%M:%S",
        stream=sys.stderr,
    )


def leave(work: Callable[[], int]) -> NoReturn:
    """Run `work` and end the process with its exit code, without waiting for any thread.

    The first Ctrl-C or SIGTERM ends it. Later ones change nothing: they would cut short what
    tidies up, and leave processes behind.
    """

    def ended(number: int, _frame: FrameType | None) -> None:
        for each in (signal.SIGINT, signal.SIGTERM):
            signal.signal(each, signal.SIG_IGN)
        raise KeyboardInterrupt if number == signal.SIGINT else Terminated

    signal.signal(signal.SIGTERM, ended)
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:  # as it is behind nohup and &
        signal.signal(signal.SIGINT, ended)
    sys.setswitchinterval(_SWITCH_SECONDS)
    try:
        code = work()
    except UsageError as error:
        code = _say(error, 2)
    except DppoError as error:
        code = _say(error, 1)
    except (KeyboardInterrupt, Terminated, BrokenPipeError):
        code = 0
    except OSError as error:
        code = _say(error, 1)
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError):  # a pipe that nobody reads, a file on a full disk
            stream.flush()
    os._exit(code)


def _say(error: Exception, code: int) -> int:
    print(f"error: {error}", file=sys.stderr)
    return code
