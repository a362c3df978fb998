"""Ctrl-C and SIGTERM: the first ends the run at the next round, the second at once.

The iteration under way is given up; the checkpoint is the last whole one (docs/decisions/0008).

Under a supervisor (`learner/supervisor.py`) a second one changes nothing: it may be the same one,
sent to both processes. The supervisor knows, and ends this process if it is to end at once.
"""

import logging
import os
import signal
from concurrent.futures import wait
from pathlib import Path
from types import FrameType

from dppo.process import Terminated
from dppo.signals import heeded
from learner.disk import Disk

_LAST_LINES_SECONDS = 5.0

log = logging.getLogger("learner")


class StopSignals:
    """Takes over both signals from when it is made."""

    def __init__(self, supervisor: int | None = None) -> None:
        """`supervisor` is the parent's process id, if this learner ends with its parent."""
        put_off, _ = signal.setitimer(signal.ITIMER_REAL, 0)  # one that came during an import
        self._asked, self._supervisor = put_off > 0, supervisor
        for number in heeded():
            signal.signal(number, self._arrived)

    def check(self) -> None:
        """Raise `Terminated` if a signal has arrived, or the supervisor is gone."""
        if self._asked:
            raise Terminated
        if self._supervisor is not None and os.getppid() != self._supervisor:
            log.warning("the supervisor, pid %d, is gone; stopping", self._supervisor)
            raise Terminated

    def restore(self) -> None:
        """From here on, signals have no meaning: the run is over."""
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_IGN)

    def _arrived(self, number: int, _frame: FrameType | None) -> None:
        if self._asked and self._supervisor is None:
            os._exit(128 + number)
        self._asked = True


class FileHandler(logging.Handler):
    """Log lines to a file, in a thread of its own: no line waits for the disk, none is torn."""

    def __init__(self, path: Path) -> None:
        super().__init__(logging.INFO)
        self._disk = Disk(path.parent, "")  # when it fails, the other files' warning says so
        size = path.stat().st_size if path.exists() else 0
        self._file = self._disk.file(path.name, size)

    def emit(self, record: logging.LogRecord) -> None:
        """Take one line."""
        try:
            self._file.write((self.format(record) + "\n").encode(errors="replace"))
        except Exception:
            self.handleError(record)  # as every handler: a bad line ends no run

    def settle(self) -> None:
        """Wait, not for long, until the lines are written."""
        wait([self._disk.run(self._disk.write_out)], _LAST_LINES_SECONDS)


def log_to_file(path: Path) -> FileHandler:
    """Log lines go to the run directory, too."""
    handler = FileHandler(path)
    handler.setFormatter(logging.Formatter("%(asctime)s %(name)s: %(message)s"))
    root = logging.getLogger()
    for console in root.handlers:
        console.setLevel(root.level)
    root.addHandler(handler)
    root.setLevel(logging.INFO)
    return handler
