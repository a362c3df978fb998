"""Who works on which slot. A state machine without clock or socket.

Slots are spread in runs over the workers in the order they joined, once per iteration, so that all
are likely to be done at the same time. Within an iteration a lease only moves when its holder is
lost. Workers that hold nothing stand by as spares.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

_WORTH_A_MOVE = 1.2
"""Slots move for speed alone when the slowest worker would be done so many times sooner."""
_ALIKE = 2.0
"""A worker counts as slow when it takes so many times as long as the fastest; clocks are noisy."""
_PATIENCE = 3
"""Iterations running that a move has to be worth it."""


@dataclass(slots=True)
class Leases:
    """Leases of slots 0 .. num_slots - 1."""

    num_slots: int
    workers: list[str] = field(default_factory=list)
    """In the order they joined."""
    holder: dict[int, str] = field(default_factory=dict)
    """Slot to worker; a slot that is not in it waits for a worker."""
    current: set[int] = field(default_factory=set)
    """Slots whose holder has their state at the start of the present iteration, or later."""
    seconds: Mapping[str, float] = field(default_factory=dict)
    """Seconds per slot, of workers that have been measured; others count as the fastest one."""
    spread_over: tuple[str, ...] = ()
    """The workers of the last spread, if none of them has left since."""
    worth_it: int = 0
    """Iterations running that a move would have been worth it."""

    def join(self, worker: str) -> tuple[int, ...]:
        """A worker joins; the slots it takes over at once, because nobody holds them."""
        if worker not in self.workers:
            self.workers.append(worker)
        return self._settle()

    def leave(self, *gone: str) -> dict[str, tuple[int, ...]]:
        """Workers are lost; who of those that stay takes over which of their slots."""
        if not set(gone) & set(self.workers):
            return {}
        self.workers = [worker for worker in self.workers if worker not in gone]
        self.spread_over = ()
        lost = {slot for slot, holder in self.holder.items() if holder in gone}
        for slot in lost:
            del self.holder[slot]
        self.current -= lost
        self._settle()
        return {
            heir: taken
            for heir in self.workers
            if (taken := tuple(slot for slot in sorted(lost) if self.holder[slot] == heir))
        }

    def spread(self) -> None:
        """The leases of a new iteration. A slot that moves is no longer current."""
        if not self.workers:
            return
        counts = dict.fromkeys(self.workers, 0)
        for _ in range(self.num_slots):
            counts[self._soonest(counts)] += 1
        if self.spread_over == tuple(self.workers):
            self.worth_it = self.worth_it + 1 if self._is_worth_it(counts) else 0
            if self.worth_it < _PATIENCE:
                return
        self.spread_over, self.worth_it = tuple(self.workers), 0
        slots = iter(range(self.num_slots))
        for worker, count in counts.items():
            for slot in (next(slots) for _ in range(count)):
                if self.holder.get(slot) != worker:
                    self.holder[slot] = worker
                    self.current.discard(slot)

    def mark_current(self, slot: int, worker: str) -> None:
        """`worker` has computed the slot's present iteration."""
        if self.holder.get(slot) == worker:
            self.current.add(slot)

    def slots_of(self, worker: str) -> tuple[int, ...]:
        """The slots a worker holds, in order."""
        return tuple(slot for slot in sorted(self.holder) if self.holder[slot] == worker)

    @property
    def spares(self) -> tuple[str, ...]:
        """Workers that hold nothing."""
        busy = set(self.holder.values())
        return tuple(worker for worker in self.workers if worker not in busy)

    def _settle(self) -> tuple[int, ...]:
        """Give slots that nobody holds to whoever would be done with one more the soonest."""
        waiting = tuple(slot for slot in range(self.num_slots) if slot not in self.holder)
        if not self.workers:
            return ()
        counts = self._counts()
        for slot in waiting:
            self.holder[slot] = worker = self._soonest(counts)
            counts[worker] += 1
        return waiting

    def _counts(self) -> dict[str, int]:
        """Slots of each worker, in the order they joined."""
        return {worker: len(self.slots_of(worker)) for worker in self.workers}

    def _soonest(self, counts: Mapping[str, int]) -> str:
        """Who would be done first with one slot more; of equals the one that joined first."""
        return min(self.workers, key=lambda worker: self._end(worker, counts[worker] + 1))

    def _end(self, worker: str, slots: int) -> float:
        """When a worker would be done with so many slots, in slots of the fastest worker."""
        fastest = min(self.seconds.values(), default=1.0)
        slowness = self.seconds.get(worker, fastest) / fastest
        return slots * (slowness if slowness >= _ALIKE else 1.0)

    def _is_worth_it(self, counts: Mapping[str, int]) -> bool:
        """Would the last worker be done so much sooner that slots should move?"""
        before = max(self._end(worker, count) for worker, count in self._counts().items())
        after = max(self._end(worker, count) for worker, count in counts.items())
        return before > _WORTH_A_MOVE * after
