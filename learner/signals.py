"""Ctrl-C and SIGTERM: the first ends the run at the next round, the second at once.

The iteration under way is given up; the checkpoint is the last whole one (docs/decisions/0008).
"""

import logging
import os
import signal
from pathlib import Path
from types import FrameType

from dppo.process import Terminated


class StopSignals:
    """Takes over both signals from when it is made."""

    def __init__(self) -> None:
        self._asked = False
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._arrived)

    def check(self) -> None:
        """Raise `Terminated` if a signal has arrived."""
        if self._asked:
            raise Terminated

    def restore(self) -> None:
        """From here on, signals have no meaning: the run is over."""
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_IGN)

    def _arrived(self, number: int, _frame: FrameType | None) -> None:
        if self._asked:
            os._exit(128 + number)
        self._asked = True


def log_to_file(path: Path) -> None:
    """Log lines go to the run directory, too."""
    handler = logging.FileHandler(path)
    handler.setFormatter(logging.Formatter("%(asctime)s %(name)s: %(message)s"))
    handler.setLevel(logging.INFO)
    root = logging.getLogger()
    for console in root.handlers:
        console.setLevel(root.level)
    root.addHandler(handler)
    root.setLevel(logging.INFO)
