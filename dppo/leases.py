"""Who works on which slot. A state machine without clock or socket.

Slots are spread evenly, in runs, over the workers in the order they joined, once per iteration.
Within an iteration a lease only moves when its holder is lost. Workers beyond the number of slots
stand by as spares and inherit first.
"""

from dataclasses import dataclass, field


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

    def join(self, worker: str) -> tuple[int, ...]:
        """A worker joins; the slots it takes over at once, because nobody holds them."""
        if worker not in self.workers:
            self.workers.append(worker)
        return self._settle()

    def leave(self, worker: str) -> dict[str, tuple[int, ...]]:
        """A worker is lost; who takes over which of its slots."""
        if worker not in self.workers:
            return {}
        self.workers.remove(worker)
        lost = {slot for slot, holder in self.holder.items() if holder == worker}
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
        """The leases of a new iteration: even runs of slots. A moved slot is no longer current."""
        active = self.workers[: self.num_slots]
        for index, worker in enumerate(active):
            first = index * self.num_slots // len(active)
            last = (index + 1) * self.num_slots // len(active)
            for slot in range(first, last):
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
        """Give slots that nobody holds to whoever holds the fewest; those slots."""
        waiting = tuple(slot for slot in range(self.num_slots) if slot not in self.holder)
        if not self.workers:
            return ()
        for slot in waiting:
            self.holder[slot] = min(
                self.workers, key=lambda worker: (len(self.slots_of(worker)), worker)
            )
        return waiting
