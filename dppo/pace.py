"""How fast each worker collects a slot. A state machine without clock or socket."""

from collections import Counter, deque
from dataclasses import dataclass, field
from statistics import median

_NEWEST = 5
"""Collections that count."""
_LEAST_SECONDS = 1e-6
"""No clock is finer: a pace is never nothing."""
_FORGIVEN = 200
"""Iterations that a spare stands by until its pace is forgotten, so that it is tried again."""


@dataclass(slots=True)
class Pace:
    """Seconds per slot of each worker, the median of its newest collections."""

    _begun: dict[str, tuple[float, tuple[int, ...]]] = field(default_factory=dict)
    _held: dict[str, tuple[int, ...]] = field(default_factory=dict)
    """What each collected last; a new set of slots has to be set up first."""
    _seconds: dict[str, deque[float]] = field(default_factory=dict)
    _idle: Counter[str] = field(default_factory=Counter)

    def begin(self, worker: str, slots: tuple[int, ...], now: float) -> None:
        """A worker is asked to collect these slots."""
        self._begun[worker] = now, slots

    def end(self, worker: str, now: float) -> None:
        """It has sent the last of them."""
        if worker not in self._begun:
            return
        then, slots = self._begun.pop(worker)
        self._idle[worker] = 0
        before, self._held[worker] = self._held.get(worker), slots
        if before != slots:
            return
        seconds = max(now - then, _LEAST_SECONDS) / len(slots)
        self._seconds.setdefault(worker, deque(maxlen=_NEWEST)).append(seconds)

    def stand_by(self, worker: str) -> None:
        """It collects nothing in this iteration."""
        self._idle[worker] += 1
        if self._idle[worker] > _FORGIVEN:
            self.forget(worker)

    def spoil(self, worker: str) -> None:
        """It does something else beside it: this collection does not count."""
        self._begun.pop(worker, None)
        self._held.pop(worker, None)

    def forget(self, worker: str) -> None:
        """It is gone."""
        self._begun.pop(worker, None)
        self._seconds.pop(worker, None)
        self._idle.pop(worker, None)
        self._held.pop(worker, None)

    @property
    def seconds_per_slot(self) -> dict[str, float]:
        """Of every worker that has been measured."""
        return {worker: median(seconds) for worker, seconds in self._seconds.items()}
