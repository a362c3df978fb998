"""Growing waits with jitter: those who wait for the same thing do not ask in step.

The jitter is part of no result, so it comes from no stream.
"""

import random
from dataclasses import dataclass


@dataclass(slots=True)
class Backoff:
    """Each wait is about twice the one before, up to `longest`; all in seconds."""

    first: float
    longest: float
    _whole: float = 0.0
    """The next wait before jitter; 0: none was taken yet."""

    def next(self) -> float:
        """Seconds to wait before the next try: between half of the whole wait and all of it."""
        whole = self._whole or self.first
        self._whole = min(2 * whole, self.longest)
        return whole * random.uniform(0.5, 1.0)

    def again(self) -> None:
        """Begin with the first wait again."""
        self._whole = 0.0
