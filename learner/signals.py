"""Ctrl-C and SIGTERM: the first ends the run at the next round, the second at once.

The iteration under way is given up; the checkpoint is the last whole one (docs/decisions/0008).

Under a supervisor (`learner/supervisor.py`) a second one changes nothing: it may be the same one,
sent to both processes. The supervisor knows, and ends this process if it is to end at once.
"""

import logging
import os
import signal
from types import FrameType

from dppo.process import Terminated
from dppo.signals import heeded

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

    def ignore(self) -> None:
        """From here on, signals have no meaning: the run is over."""
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_IGN)

    def _arrived(self, number: int, _frame: FrameType | None) -> None:
        if self._asked and self._supervisor is None:
            os._exit(128 + number)
        self._asked = True
