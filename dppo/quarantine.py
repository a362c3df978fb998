"""Answers that cannot be believed. A state machine without clock or socket.

An answer that is not finite, or a million times larger than what is usual, is refused and computed
again, elsewhere if there is somebody else. What comes out so a second time is no fault of a
worker: it is the computation. A worker whose answers are refused again and again is benched.
"""

from collections import Counter, deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from statistics import median

from dppo.rounds import RoundId

WILD = 1e6
"""An answer is an outlier when it is so many times as large as the median of those before it.

Targets of σ and losses are squares: one fall of a policy that never falls makes them ten thousand
times as large. What is damaged or invented is larger by far.
"""
BENCHED = 3
"""Refusals after which a worker is sent away."""
_NEWEST = 255
_LEAST = 8
_EVERY = 16


@dataclass(slots=True)
class _Usual:
    """The median of the newest sizes of one kind; at least 1, so that nothing small is wild."""

    sizes: deque[float] = field(default_factory=lambda: deque(maxlen=_NEWEST))
    median: float = 1.0
    noted: int = 0

    def note(self, size: float) -> None:
        self.sizes.append(size)
        self.noted += 1
        if self.noted < _EVERY or self.noted % _EVERY == 0:
            self.median = max(1.0, median(self.sizes))


@dataclass(slots=True)
class Quarantine:
    """What is usual, who was refused, and what was refused in the round under way."""

    _usual: dict[str, _Usual] = field(default_factory=dict)
    _refusals: Counter[str] = field(default_factory=Counter)
    _round: RoundId | None = None
    _refused: dict[int, str] = field(default_factory=dict)
    """Of the round under way: slot to the worker whose answer was refused."""

    def outlier(self, sizes: Mapping[str, float]) -> str:
        """What of an answer is wildly large, in words; empty if nothing is."""
        for name, size in sizes.items():
            usual = self._usual.get(name)
            if usual is None or len(usual.sizes) < _LEAST:
                continue
            if size > WILD * usual.median:
                return f"{name} {size:.3g}, the median of the newest ones is {usual.median:.3g}"
        return ""

    def accept(self, sizes: Mapping[str, float]) -> None:
        """An answer counts: its sizes are usual from now on."""
        for name, size in sizes.items():
            if size > 0:  # nothing was measured, e.g. no episode began
                self._usual.setdefault(name, _Usual()).note(size)

    def refuse(self, worker: str, slots: Iterable[int], round_id: RoundId) -> str | None:
        """Refuse a worker's answer about slots.

        Returns:
            None: ask again. A worker's name: one of these slots was refused before in this round,
            from that worker (the same one, if there is no other), so it was not to blame.
        """
        if round_id != self._round:
            self._round = round_id
            self._refused.clear()
        before = next((self._refused[slot] for slot in slots if slot in self._refused), None)
        self._refused.update(dict.fromkeys(slots, worker))
        if before is None:
            self._refusals[worker] += 1
        else:
            self._refusals[before] -= 1
        return before

    def is_benched(self, worker: str) -> bool:
        """Have its answers been refused too often?"""
        return self._refusals[worker] >= BENCHED
