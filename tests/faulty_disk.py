"""A disk that fails at the k-th call that changes it: with an error, half-way, or by a power cut.

Only `os` is in between: what is tested is what the program asks of the operating system.
"""

import contextlib
import os
import stat
from collections.abc import Callable, Iterator
from typing import Any

import pytest

CALLS = (
    "open", "write", "pwrite", "fsync", "close", "ftruncate", "rename", "replace", "mkdir",
    "unlink", "rmdir", "scandir",
)  # fmt: skip
"""What the program does to a disk, by whatever name; `Path` and `shutil` end there, too."""
WAYS = ("power cut", "killed", "killed half-way", "fails once", "fails on")
"""Ways to fail at the k-th call. Only those of WAYS[:3] take the process with them: every later
call raises, too, so that nothing is tidied up. A power cut also takes what was not flushed."""


class PowerCut(BaseException):
    """The machine stops."""


class FaultyDisk:
    """Fails at the `at`-th call, counted from 1, in one of the `WAYS`."""

    def __init__(self, patch: pytest.MonkeyPatch, at: int, way: str, errno: int = 28) -> None:
        self.calls: list[str] = []
        self.unflushed: dict[int, int] = {}
        self._at, self._way, self._errno = at, way, errno
        self._real = {name: getattr(os, name) for name in CALLS}
        for name in CALLS:
            patch.setattr(os, name, self._watched(name))

    def _watched(self, name: str) -> Callable[..., Any]:
        def call(*args: Any, **kwargs: Any) -> Any:
            self.calls.append(name)
            if len(self.calls) >= self._at and self._way in WAYS[:3]:
                self._end(name, args)
            if len(self.calls) == self._at or (
                len(self.calls) > self._at and self._way == "fails on" and name != "close"
            ):
                self._fail(name, args)
            result = self._real[name](*args, **kwargs)
            self._note(name, args, result)
            return result

        return call

    def _end(self, name: str, args: tuple[Any, ...]) -> None:
        """The process is gone; half of a write may have been done."""
        if self._way == "killed half-way" and len(self.calls) == self._at:
            self._half(name, args)
        if self._way == "power cut":
            while self.unflushed:
                handle = self.unflushed.popitem()[1]
                self._real["ftruncate"](handle, 0)
                self._real["close"](handle)
        raise PowerCut

    def _fail(self, name: str, args: tuple[Any, ...]) -> None:
        self._half(name, args)
        if name == "close":
            self._real["close"](*args)  # a failed close has closed
        raise OSError(self._errno, os.strerror(self._errno))

    def _half(self, name: str, args: tuple[Any, ...]) -> None:
        if name in ("write", "pwrite"):
            handle, data, *offset = args
            self._real[name](handle, bytes(data)[: len(data) // 2], *offset)

    def _note(self, name: str, args: tuple[Any, ...], result: Any) -> None:
        """Which files are not flushed; kept open to be emptied."""
        if name == "open" and args[1] & os.O_WRONLY:
            self.unflushed[os.fstat(result).st_ino] = os.dup(result)
        if name == "fsync" and stat.S_ISREG(os.fstat(args[0]).st_mode):
            handle = self.unflushed.pop(os.fstat(args[0]).st_ino, None)
            if handle is not None:
                self._real["close"](handle)


def interrupted(work: Callable[[], Any], way: str, errno: int = 28) -> Iterator[FaultyDisk]:
    """Do `work()` again and again, failing at the first call, the second, ... until none fails."""
    for at in range(1, 500):
        with pytest.MonkeyPatch.context() as patch:
            disk = FaultyDisk(patch, at, way, errno)
            with contextlib.suppress(OSError, PowerCut):
                work()
        for handle in disk.unflushed.values():
            os.close(handle)
        yield disk
        if len(disk.calls) < at:
            return
    pytest.fail("the work never ends")
