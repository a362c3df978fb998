"""Signals as values that can be waited for: in those who start other processes and end them.

Loads nothing but the standard library, because the supervisor does not.
"""

import os
import select
import signal
import time


def heeded() -> list[signal.Signals]:
    """Those that ask for an end, but SIGINT where it is ignored, as behind nohup and `&`."""
    ignored = signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    return [signal.SIGTERM] if ignored else [signal.SIGTERM, signal.SIGINT]


class Signals:
    """SIGTERM, SIGINT and SIGCHLD as values that can be waited for."""

    def __init__(self) -> None:
        """Takes the three over from here on."""
        self._reader, writer = os.pipe()
        os.set_blocking(writer, False)
        signal.set_wakeup_fd(writer)
        for number in (*heeded(), signal.SIGCHLD):
            signal.signal(number, lambda _number, _frame: None)

    def next(self, timeout: float | None) -> int | None:
        """The number of the next one that arrives; None after `timeout` seconds."""
        readable, _, _ = select.select([self._reader], [], [], timeout)
        return os.read(self._reader, 1)[0] if readable else None

    def next_request(self, seconds: float) -> int | None:
        """The next that asks for an end; None after so many seconds."""
        until = time.monotonic() + seconds
        while (left := until - time.monotonic()) > 0:
            number = self.next(left)
            if number in (signal.SIGTERM, signal.SIGINT):
                return number
        return None
