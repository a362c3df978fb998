"""Signs of life: how much this process has done, told to the learner twice a second.

The count is the process's own, whichever membership it serves. It grows with every step of an
environment and every task; when it stands still, something hangs.
"""

import threading
from collections.abc import Callable
from types import TracebackType

from dppo.wire.messages import Alive

SECONDS = 0.5
"""Between two signs of life."""


class _Count:
    done = 0


def beat() -> None:
    """Something was done."""
    _Count.done += 1


class Heart:
    """Beats beside a membership, in a thread of its own, as long as the context lasts."""

    def __init__(self, worker: str, generation: int, send: Callable[[Alive], None]) -> None:
        """`send` is called in the other thread."""
        self._worker, self._generation, self._send = worker, generation, send
        self._over = threading.Event()

    def __enter__(self) -> None:
        """Begin."""
        threading.Thread(target=self._live, daemon=True).start()

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End."""
        self._over.set()

    def _live(self) -> None:
        while not self._over.wait(SECONDS):
            self._send(Alive(worker=self._worker, generation=self._generation, done=_Count.done))
