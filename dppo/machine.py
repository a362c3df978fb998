"""What a process gets from its machine: threads, cores, memory, a screen, ports, an end."""

import contextlib
import ctypes.util
import importlib.util
import os
import signal
import socket
import sys
from pathlib import Path

THREAD_VARIABLES = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
"""What numeric libraries read, once, when they are imported."""
_PR_SET_PDEATHSIG = 1
"""From Linux's sys/prctl.h."""


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


def end_with_parent() -> None:
    """Let the system kill this process when its parent ends, where it can (Linux).

    Whatever this process does then: an environment that never gives back the interpreter, too.
    """
    with contextlib.suppress(AttributeError):
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


def usable_cores() -> int:
    """Cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def own_program(module: str, *words: str) -> list[str]:
    """Command line of a module of ours; a file of its name in the current folder is not it."""
    return [sys.executable, "-P", "-m", module, *words]


def free_port() -> int:
    """A loopback port that was free a moment ago."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port
