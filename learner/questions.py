"""What the workers have been asked and still owe: the present round, and answers to older ones.

A slot whose holder lacks its state is brought up to date first: its environments are restored, the
iteration is collected again, and then it joins at the present question.
"""

from dataclasses import dataclass, replace

from dppo.leases import Leases
from dppo.rounds import Round, RoundId
from dppo.wire.links import LearnerLink
from dppo.wire.messages import (
    Answer,
    Collect,
    Collected,
    Gradient,
    Measure,
    Measured,
    Restore,
    Task,
    Update,
)
from learner.soundness import block_of

_ANSWER_TO: dict[type[Task], type[Answer]] = {
    Collect: Collected, Update: Gradient, Measure: Measured
}  # fmt: skip


@dataclass(slots=True)
class _Owed:
    """The newest question a worker has been asked, and the slots it still owes answers for."""

    id: RoundId
    kind: type[Answer]
    slots: set[int]


class Questions:
    """Asks the holders of slots; one question per worker is under way."""

    def __init__(self, link: LearnerLink, leases: Leases) -> None:
        self._link, self._leases = link, leases
        self._owed: dict[str, _Owed] = {}
        self._collect: Collect | None = None
        self._snapshots: dict[int, bytes] = {}
        self.task: Task | None = None
        self.round: Round[Answer] | None = None
        """The round under way, if any."""

    def begin_iteration(self, collect: Collect, snapshots: dict[int, bytes]) -> None:
        """Remember what a lost slot has to be started from."""
        self._collect, self._snapshots = collect, snapshots

    def open(self, task: Task, quorum: int) -> Round[Answer]:
        """Put a question to the holders of all slots; its round."""
        self.task = task
        self.round = Round(
            RoundId(task.generation, task.iteration, task.round), task.slots, quorum
        )
        for worker in list(self._leases.workers):
            self.ask(worker, self._leases.slots_of(worker))
        return self.round

    def close(self) -> None:
        """The round is over: what still comes is late."""
        self.round = None

    def owes(self, worker: str) -> bool:
        """Has it been asked something that it has not answered?"""
        owed = self._owed.get(worker)
        return owed is not None and bool(owed.slots)

    def forget(self, worker: str) -> None:
        """A worker is lost, and what it owes with it."""
        self._owed.pop(worker, None)

    def ask(self, worker: str, slots: tuple[int, ...]) -> None:
        """Put the present question to a worker, for those of `slots` that have not answered."""
        if self.round is None:
            return
        assert self.task is not None
        missing = set(self.round.missing)
        wanted = tuple(slot for slot in slots if slot in missing)
        owed = self._owed.get(worker)
        if not wanted or (owed is not None and owed.slots and owed.id != self.round.id):
            return  # a late worker is asked again when it has answered
        self._bring_up_to_date(worker, wanted)
        self._link.send(worker, replace(self.task, slots=wanted))
        before = owed.slots if owed is not None else set()
        kind = _ANSWER_TO[type(self.task)]
        self._owed[worker] = _Owed(self.round.id, kind, before | set(wanted))

    def _bring_up_to_date(self, worker: str, slots: tuple[int, ...]) -> None:
        """Before the present question: what the worker lacks of `slots`."""
        collect = self._collect
        assert collect is not None
        lacking = tuple(slot for slot in slots if slot not in self._leases.current)
        for slot in lacking:
            if slot in self._snapshots:
                self._link.send(
                    worker,
                    Restore(
                        generation=collect.generation,
                        iteration=collect.iteration,
                        slot=slot,
                        snapshot=self._snapshots[slot],
                    ),
                )
        if lacking and not isinstance(self.task, Collect):
            self._link.send(worker, replace(collect, slots=lacking))

    def settle(self, answer: Answer, round_id: RoundId) -> bool:
        """Note what an answer says about its sender; was it asked for, and is it the first one?"""
        if isinstance(answer, Collected) and self._is_present(answer):
            self._leases.mark_current(answer.slot, answer.worker)
        owed = self._owed.get(answer.worker)
        first, size = block_of(answer)
        slots = set(range(first, first + min(size, self._leases.num_slots + 1)))
        if owed is None or owed.id != round_id or not slots <= owed.slots:
            return False
        if not isinstance(answer, owed.kind):
            return False
        owed.slots -= slots
        late = self.round is not None and owed.id != self.round.id
        if late and not owed.slots and answer.worker in self._leases.workers:
            self.ask(answer.worker, self._leases.slots_of(answer.worker))
        return True

    def _is_present(self, answer: Collected) -> bool:
        """Was it collected in the present iteration?"""
        collect = self._collect
        return (
            collect is not None
            and answer.generation == collect.generation
            and answer.iteration == collect.iteration
        )
