"""How long something may take before we go on without it, learned from how long it took lately.

A state machine without a clock: durations are passed in. The limit is the median plus a few
deviations, where the deviation is the median absolute one: a few outliers move neither.
"""

from collections import deque
from dataclasses import dataclass, field
from statistics import median

WINDOW = 64
"""Durations that count unless told otherwise, the newest ones [count]."""
ENOUGH = 8
"""Durations without which `first` is the limit [count]."""
_TO_STANDARD = 1.4826
"""A normal distribution's standard deviation, in median absolute deviations."""
_MOST_DOUBLINGS = 16


@dataclass(slots=True)
class Patience:
    """A limit on durations that adapts to them.

    Example:
        patience = Patience(first=30.0, least=1.0)
        patience.note(0.2)
        patience.limit  # 30.0: one duration says little
    """

    first: float
    """The limit before enough durations are known [s]."""
    least: float
    """The limit is never below this [s]."""
    deviations: float = 5.0
    """How many standard deviations above the median the limit is [count]."""
    window: int = WINDOW
    """How many of the newest durations count [count]."""
    _durations: deque[float] = field(init=False)
    _doublings: int = 0

    def __post_init__(self) -> None:
        """Nothing is known at first."""
        self._durations = deque(maxlen=self.window)

    def note(self, seconds: float) -> None:
        """It took so long."""
        self._durations.append(seconds)

    def double(self) -> None:
        """The limit was too short: something was given up in vain."""
        self._doublings = min(self._doublings + 1, _MOST_DOUBLINGS)

    def calm(self) -> None:
        """All is well: the limit is again what the durations say."""
        self._doublings = 0

    @property
    def limit(self) -> float:
        """How long to wait [s]: max(least, median + deviations x 1.4826 MAD), doubled or not."""
        limit: float = self.first
        if len(self._durations) >= ENOUGH:
            middle = median(self._durations)
            spread = _TO_STANDARD * median(abs(each - middle) for each in self._durations)
            limit = max(self.least, middle + self.deviations * spread)
        return limit * float(1 << self._doublings)
