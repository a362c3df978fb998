"""Answers that cannot be believed. A state machine without clock or socket.

An answer that is not finite, or a million times larger than is usual, is refused and computed
again, elsewhere if there is somebody else. What comes out so a second time is no fault of a
worker: it is the computation. A worker whose refused answers come out otherwise elsewhere, again
and again, is benched.
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
"""Refused answers that came out otherwise elsewhere, after which a worker is sent away."""
_NEVER = 1e20
"""Nothing is so large, unless it comes out twice."""
_NEWEST = 255
_LEAST = 8
_EVERY = 16


@dataclass(slots=True)
class _Usual:
    """The median of the newest sizes of one kind; at least 1, so that nothing small is wild."""

    sizes: deque[float] = field(default_factory=lambda: deque(maxlen=_NEWEST))
    median: float = 1.0
    noted: int = 0
    confirmed: float = 0.0
    """The largest size that was wild and came out twice."""

    def note(self, size: float) -> None:
        self.sizes.append(size)
        self.noted += 1
        if self.noted < _EVERY or self.noted % _EVERY == 0:
            self.median = max(1.0, median(self.sizes))

    def is_wild(self, size: float) -> bool:
        known = len(self.sizes) >= _LEAST
        usual = min(WILD * self.median, _NEVER) if known else _NEVER
        return size > max(usual, 10 * self.confirmed)


@dataclass(frozen=True, slots=True)
class _Refused:
    """One answer: from whom, about which slots."""

    worker: str
    slots: tuple[int, ...]


@dataclass(slots=True)
class _Memory:
    """Whose answers about which slots were refused in one round."""

    round: RoundId | None = None
    refused: dict[int, _Refused] = field(default_factory=dict)

    def of(self, round_id: RoundId) -> dict[int, _Refused]:
        """By slot; empty in a new round."""
        if round_id != self.round:
            self.round = round_id
            self.refused.clear()
        return self.refused


@dataclass(slots=True)
class Quarantine:
    """What is usual, who was refused, and what was refused in the round under way."""

    _usual: dict[str, _Usual] = field(default_factory=dict)
    _refuted: Counter[str] = field(default_factory=Counter)
    """Of each worker, refused answers that came out otherwise elsewhere."""
    _answers: _Memory = field(default_factory=_Memory)
    _failures: _Memory = field(default_factory=_Memory)

    def outlier(self, sizes: Mapping[str, float]) -> str:
        """What of an answer is wildly large, in words; empty if nothing is."""
        for name, size in sizes.items():
            usual = self._usual.get(name, _Usual())
            if usual.is_wild(size):
                return f"{name} {size:.3g}, the median of the newest ones is {usual.median:.3g}"
        return ""

    def accept(
        self, sizes: Mapping[str, float], slots: Iterable[int], round_id: RoundId
    ) -> list[str]:
        """An answer counts: its sizes are usual from now on; workers to be benched for theirs."""
        for name, size in sizes.items():
            if size > 0:  # nothing was measured, e.g. no episode began
                self._usual.setdefault(name, _Usual()).note(size)
        refused = self._answers.of(round_id)
        refuted = (
            {refused.pop(slot).worker for slot in slots if slot in refused} if refused else set()
        )
        self._refuted.update(refuted)
        return sorted(worker for worker in refuted if self._refuted[worker] >= BENCHED)

    def refuse(self, worker: str, slots: Iterable[int], round_id: RoundId) -> str | None:
        """Refuse a worker's answer about slots.

        Returns:
            None: ask again. A worker's name: one of these slots was refused before in this round,
            from that worker (the same one, if there is no other), so it was not to blame.
        """
        return self._again(self._answers.of(round_id), worker, slots)

    def fail(self, worker: str, slot: int, iteration: RoundId) -> str | None:
        """An environment of a slot has failed; as `refuse`."""
        return self._again(self._failures.of(iteration), worker, (slot,))

    def confirm(self, sizes: Mapping[str, float], slots: Iterable[int], round_id: RoundId) -> None:
        """A wild answer has come out twice: nobody is to blame, and such sizes may come again."""
        refused = self._answers.of(round_id)
        for answer in [refused[slot] for slot in slots if slot in refused]:
            for slot in answer.slots:  # the rest of it may come from others, and is as it was
                refused.pop(slot, None)
        for name, size in sizes.items():
            usual = self._usual.setdefault(name, _Usual())
            if usual.is_wild(size):
                usual.confirmed = size

    def _again(
        self, refused: dict[int, _Refused], worker: str, slots: Iterable[int]
    ) -> str | None:
        answer = _Refused(worker, tuple(slots))
        before = next((refused[slot].worker for slot in answer.slots if slot in refused), None)
        for slot in answer.slots:
            refused.setdefault(slot, answer)
        return before
