"""The one thread that writes to the run directory, and the files in it that only grow.

Nothing here waits for the disk but that thread: on a full, read-only, slow or hanging disk lines
appear late and cost memory, but no time. Jobs run in the order in which they were given, so what
was logged before a checkpoint is in the files before the checkpoint is.
"""

import contextlib
import errno
import logging
import os
import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from pathlib import Path

log = logging.getLogger("disk")
_REMARK_SECONDS = 10.0
_PAUSE_SECONDS = 0.25
_SETTLE_SECONDS = 5.0
"""Longest wait for the last lines."""
MOST_WAITING = 64 * 2**20
"""Of one file that the disk does not take [bytes]."""


class GrowingFile:
    """Appends lines or records, each as a whole; keeps what the disk does not take."""

    def __init__(self, path: Path, size: int, changed: Callable[[], None]) -> None:
        """Go on after `size` bytes, what is beyond them is cut; `changed`: there is work."""
        self.path, self.lost = path, 0
        self._size, self._changed = size, changed
        self._waiting: deque[bytes] = deque()
        self._waiting_bytes = 0
        self._is_cut = False
        self._lock = threading.Lock()

    @property
    def waiting(self) -> int:
        """Lines that are not in the file yet."""
        return len(self._waiting)

    def write(self, data: bytes) -> None:
        """Take one line or record; if there are too many, the oldest is lost."""
        with self._lock:
            self._waiting.append(data)
            self._waiting_bytes += len(data)
            while self._waiting_bytes > MOST_WAITING and len(self._waiting) > 1:
                self._waiting_bytes -= len(self._waiting.popleft())
                self.lost += 1
        self._changed()

    def write_out(self) -> None:
        """Bring to the disk what it takes; in the disk's thread only.

        The file is closed again each time: some file systems report errors only then, and an open
        file would keep the disk from being mounted anew.

        Raises:
            OSError: it did not take everything; what it did take are whole lines.
        """
        if self._is_cut and not self._waiting:
            return
        handle = os.open(self.path, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC, 0o644)
        try:
            there = os.fstat(handle).st_size
            if not self._is_cut and there > self._size:
                os.ftruncate(handle, self._size)
                there = self._size
            self._size = there  # other than it was left: somebody else writes here, too
            self._is_cut = True
            while self._waiting:
                self._move_one(handle)
        finally:
            os.close(handle)

    def _move_one(self, handle: int) -> None:
        with self._lock:
            data = self._waiting.popleft()
            self._waiting_bytes -= len(data)
        done = 0
        try:
            while done < len(data):
                done += os.pwrite(handle, data[done:], self._size + done)
        except OSError:
            with self._lock:
                self._waiting.appendleft(data)
                self._waiting_bytes += len(data)
            self._is_cut = False  # the next attempt cuts what this one has left
            with contextlib.suppress(OSError):
                os.ftruncate(handle, self._size)
            raise
        self._size += len(data)


class Disk:
    """A thread for one folder, and its growing files."""

    def __init__(self, folder: Path, what: str) -> None:
        """`what` the files are is said when they cannot be written; empty: nothing is said."""
        self._folder, self._what = folder, what
        self._thread = ThreadPoolExecutor(1)
        self._files: list[GrowingFile] = []
        self._lock = threading.Lock()
        self._due = False
        self._failing = False

    def file(self, name: str, size: int) -> GrowingFile:
        """A file of the folder that goes on after `size` bytes."""
        file = GrowingFile(self._folder / name, size, self._soon)
        self._files.append(file)
        self._soon()
        return file

    def run(self, work: Callable[[], None]) -> Future[None]:
        """Do `work` in the thread, after what it was given before."""
        return self._thread.submit(work)

    def wait(
        self,
        job: Future[None],
        what: str,
        most: float = float("inf"),
        pause: Callable[[], None] = lambda: None,
    ) -> None:
        """Wait for a job, and say so when it takes long; an error of its own is raised here.

        Args:
            job: what `run` gave.
            what: it is, in words.
            most: longest wait [s].
            pause: called several times a second; it may raise to end the wait.

        Raises:
            OSError: it was not done in that time.
        """
        begun = remarked = time.monotonic()
        while not wait([job], _PAUSE_SECONDS).done:
            now = time.monotonic()
            if now - begun > most:
                raise OSError(errno.ETIMEDOUT, f"the disk has not taken it for {most:g} s")
            if now - remarked > _REMARK_SECONDS:
                remarked = now
                log.warning("waiting for the disk to take %s, for %.0f s", what, now - begun)
            pause()
        job.result()

    def write_out(self) -> None:
        """Write what waits; in the thread only. Never raises: says so, once, and keeps it."""
        with self._lock:
            self._due = False  # what comes from here on may come too late for this time
        failure: OSError | None = None
        for file in self._files:
            try:
                file.write_out()
            except OSError as error:
                failure = error
        if (failure is not None) != self._failing:
            self._failing = failure is not None
            self._say(failure)

    def settle(self) -> None:
        """Write what waits, and wait for it; say what the disk does not take."""
        with contextlib.suppress(OSError):  # it hangs: what is left is counted
            self.wait(self.run(self.write_out), self._what, _SETTLE_SECONDS)
        left = sum(file.waiting for file in self._files)
        if left and self._what:
            log.warning("%d lines of %s are still not on the disk", left, self._what)

    def _soon(self) -> None:
        with self._lock:
            due, self._due = self._due, True
        if not due:
            self.run(self.write_out)

    def _say(self, failure: OSError | None) -> None:
        if not self._what:
            return
        if failure is not None:
            log.warning(
                "%s in %s cannot be written: %s; training goes on, they are kept in memory and "
                "written when the disk takes them again",
                self._what,
                self._folder,
                failure,
            )
            return
        lost = sum(file.lost for file in self._files)
        tail = f"; {lost} lines were too many to keep and are lost" if lost else ""
        log.warning("%s are written again%s", self._what, tail)
