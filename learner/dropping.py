"""What dropping does to the slots: a function of the ledger's lines, so it outlives a learner.

Whether a slot is heard too rarely, and whether those that are dropped are the ones with higher or
longer episodes: then the average gradient leans away from them.
"""

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass

from dppo.store.ledger import IterationLine, Line, UpdateLine

RECENT = 100
"""Updates by which a slot is judged to starve [count]."""
STARVES_BELOW = 0.5
"""A slot that was accepted in less than this share of them starves."""


@dataclass(slots=True)
class Correlation:
    """Pearson's r of pairs, one pass, without keeping them."""

    count: int = 0
    x_mean: float = 0.0
    y_mean: float = 0.0
    x_square: float = 0.0
    y_square: float = 0.0
    product: float = 0.0

    def note(self, x: float, y: float) -> None:
        """One more pair (Welford)."""
        self.count += 1
        x_gap, y_gap = x - self.x_mean, y - self.y_mean
        self.x_mean += x_gap / self.count
        self.y_mean += y_gap / self.count
        self.x_square += x_gap * (x - self.x_mean)
        self.y_square += y_gap * (y - self.y_mean)
        self.product += x_gap * (y - self.y_mean)

    @property
    def value(self) -> float | None:
        """r, from -1 to 1; None if one of the two never varied."""
        if self.x_square <= 0 or self.y_square <= 0:
            return None
        return self.product / math.sqrt(self.x_square) / math.sqrt(self.y_square)


class Accounts:
    """Of each slot, how often it was accepted; over slots and iterations, what goes with it."""

    def __init__(self, slots: int) -> None:
        self.updates = 0
        self.running = [0] * slots
        """Updates running that went on without the slot."""
        self._dropped = [0] * slots
        self._in_iteration, self._dropped_in_iteration = 0, [0] * slots
        self._recent: deque[frozenset[int]] = deque(maxlen=RECENT)
        self._recently_dropped = [0] * slots
        self._starving: set[int] = set()
        self._returns, self._lengths = Correlation(), Correlation()

    @classmethod
    def of(cls, slots: int, lines: Iterable[Line]) -> "Accounts":
        """What a whole ledger says."""
        accounts = cls(slots)
        for line in lines:
            accounts.note(line)
        return accounts

    def note(self, line: Line) -> tuple[int, ...]:
        """One more line; slots that begin to starve."""
        match line:
            case UpdateLine():
                return self._note_update(frozenset(line.dropped))
            case IterationLine():
                self._note_iteration(line)
        return ()

    def _note_update(self, dropped: frozenset[int]) -> tuple[int, ...]:
        self.updates += 1
        self._in_iteration += 1
        leaving = self._recent[0] if len(self._recent) == RECENT else frozenset[int]()
        self._recent.append(dropped)
        for slot in dropped:
            self._dropped[slot] += 1
            self._dropped_in_iteration[slot] += 1
            self._recently_dropped[slot] += 1
        for slot in leaving:
            self._recently_dropped[slot] -= 1
        self.running = [
            times + 1 if slot in dropped else 0 for slot, times in enumerate(self.running)
        ]
        if len(self._recent) < RECENT:
            return ()
        starving = {
            slot
            for slot, times in enumerate(self._recently_dropped)
            if RECENT - times < STARVES_BELOW * RECENT
        }
        begun, self._starving = starving - self._starving, starving
        return tuple(sorted(begun))

    def _note_iteration(self, line: IterationLine) -> None:
        for slot, (mean_return, length) in enumerate(
            zip(line.returns, line.lengths, strict=False)
        ):
            if self._in_iteration and mean_return is not None and length is not None:
                share = self._dropped_in_iteration[slot] / self._in_iteration
                self._returns.note(share, mean_return)
                self._lengths.note(share, length)
        self._in_iteration, self._dropped_in_iteration = 0, [0] * len(self.running)

    @property
    def acceptance(self) -> list[float] | None:
        """Of each slot, the share of the run's updates it is in; None without updates noted."""
        if not self.updates:
            return None
        return [1 - dropped / self.updates for dropped in self._dropped]

    def figures(self) -> dict[str, object]:
        """For result.json."""
        return {
            "acceptance": self.acceptance,
            "drop_return_correlation": self._returns.value,
            "drop_length_correlation": self._lengths.value,
        }

    def metrics(self) -> dict[str, float]:
        """For the metric files; the acceptance is that of the newest updates. Empty: no drops."""
        if not self._recent:
            return {}
        worst = max(self._recently_dropped) / len(self._recent)
        found = {
            "cluster/acceptance_min": 1 - worst,
            "cluster/drop_return_correlation": self._returns.value,
            "cluster/drop_length_correlation": self._lengths.value,
        }
        return {name: value for name, value in found.items() if value is not None}
