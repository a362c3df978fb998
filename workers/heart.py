"""Signs of life: how much this process has done, told to the learner twice a second.

The count is the process's own, whichever membership it serves. It grows with every step of an
environment and every task; when it stands still, something hangs.
"""

import threading
from collections.abc import Callable

from dppo.wire.messages import Alive

SECONDS = 0.5
"""Between two signs of life."""
_END_SECONDS = 1.0


class _Count:
    done = 0


def beat() -> None:
    """Something was done."""
    _Count.done += 1


class Heart:
    """Beats beside a membership, in a thread of its own."""

    def __init__(self, worker: str, generation: int, send: Callable[[Alive], None]) -> None:
        """`send` is called in the other thread."""
        self._worker, self._generation, self._send = worker, generation, send
        self._over = threading.Event()
        self._thread: threading.Thread | None = None

    def begin(self) -> None:
        """Beat from now on; once is enough."""
        if self._thread is None:
            self._thread = threading.Thread(target=self._live, daemon=True)
            self._thread.start()

    def end(self) -> None:
        """Beat no more; a sign that is just being sent is waited for, but not for long."""
        self._over.set()
        if self._thread is not None:
            self._thread.join(_END_SECONDS)

    def _live(self) -> None:
        while not self._over.wait(SECONDS):
            self._send(Alive(worker=self._worker, generation=self._generation, done=_Count.done))
