"""Asks all slots something and gathers the answers, whoever holds them, whatever dies meanwhile.

The rules are in `dppo.rounds` and `dppo.leases`; this file feeds them with what arrives and
carries out what they say. A worker that is lost costs one redo of its slots: their heirs restore
the slots' environments, collect the iteration again, and join at the present question.
"""

import logging
import re
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

from dppo.errors import RunFailedError, UsageError
from dppo.leases import Leases
from dppo.rounds import Round, RoundId
from dppo.spaces import Spaces
from dppo.wire.links import LearnerLink, Refused, WorkerLost
from dppo.wire.messages import (
    Answer,
    Collect,
    Collected,
    Failure,
    Gradient,
    Hello,
    Measure,
    Measured,
    Ready,
    Restore,
    Stop,
    Task,
    Update,
    Welcome,
)
from learner.roster import Roster, spaces_in
from learner.soundness import block_of, is_finite, shape_objection

log = logging.getLogger("learner")
_TICK = 0.25
"""Longest wait for one event [s]; children and signals are looked after in between."""
_REMARK_SECONDS = 10.0
_ANSWER_TO = {Collect: Collected, Update: Gradient, Measure: Measured}


@dataclass(slots=True)
class _Busy:
    """The newest question a worker has been asked, and the slots it still owes answers for."""

    id: RoundId
    slots: set[int]


class Exchange:
    """The learner's side of every round."""

    def __init__(
        self,
        link: LearnerLink,
        welcome: Welcome,
        leases: Leases,
        look_after: Callable[[], None],
        parameter_count: Callable[[], int],
    ) -> None:
        """`look_after` is called in every pause; it may raise to end the run."""
        self._link, self._welcome, self._leases = link, welcome, leases
        self._look_after, self._parameter_count = look_after, parameter_count
        self.roster = Roster()
        self.exact = True
        """No slot has lost a bit on a move."""
        self._busy: dict[str, _Busy] = {}
        self._collect: Collect | None = None
        self._snapshots: dict[int, bytes] = {}
        self._task: Task | None = None
        self._round: Round[Answer] | None = None

    @property
    def num_workers(self) -> int:
        """Workers in the run now."""
        return len(self._leases.workers)

    def wait_for_environment(self) -> Spaces:
        """Wait until a worker has built the environment; its sizes."""
        begun = remarked = time.monotonic()
        while self.roster.first is None:
            self._handle(_TICK)
            if time.monotonic() - remarked > _REMARK_SECONDS:
                remarked = time.monotonic()
                log.warning("waiting for a first worker, for %.0f s", remarked - begun)
        return spaces_in(self.roster.first)

    def begin_iteration(self, collect: Collect, snapshots: dict[int, bytes]) -> None:
        """Spread the slots anew; remember what a lost slot has to be started from."""
        self._collect, self._snapshots = collect, snapshots
        self._leases.spread()
        if self._leases.spares and collect.iteration % 100 == 1:
            spares, slots = len(self._leases.spares), self._leases.num_slots
            log.warning("%d workers stand by: --slots %d is what limits them", spares, slots)

    def gather(self, task: Task, quorum: int) -> Round[Answer]:
        """Ask all slots, wait until the quorum is in, take what else is there; the round."""
        self._look_after()
        round_id = RoundId(task.generation, task.iteration, task.round)
        self._task, self._round = task, Round(round_id, task.slots, quorum)
        for worker in list(self._leases.workers):
            self._ask(worker, self._leases.slots_of(worker))
        begun = remarked = time.monotonic()
        while not self._round.may_close:
            self._handle(_TICK)
            if time.monotonic() - remarked > _REMARK_SECONDS:
                remarked = time.monotonic()
                log.warning("%s, for %.0f s", self._waiting_for(), remarked - begun)
        while self._round.missing and self._handle(0.0):
            pass
        closed, self._round = self._round, None
        return closed

    def stop(self, reason: str, final: bool) -> None:
        """Tell every worker that the run is over, or that this learner pauses."""
        for worker in self.roster:
            self._link.send(worker, Stop(reason=reason, final=final))

    # events

    def _handle(self, timeout: float) -> bool:
        """One event, or one silence; was it an event?"""
        event = self._link.receive(timeout)
        match event:
            case Hello():
                self._greet(event)
            case Ready():
                self._admit(event)
            case Collected() | Gradient() | Measured():
                self._take(event)
            case WorkerLost():
                self._lose(event.worker, "its connection is gone")
            case Failure():
                self._fail(event)
            case Refused():
                log.warning("ignored a message: %s", event.reason)
            case None:
                self._look_after()
        return event is not None

    def _greet(self, hello: Hello) -> None:
        if not re.fullmatch(r"[A-Za-z0-9-]{1,64}", hello.worker):
            log.warning("ignored a worker called %r: letters, digits and '-' only", hello.worker)
            return
        if hello.worker in self._leases.workers:
            self._lose(hello.worker, "it joins anew")
        self.roster.greet(hello)
        self._link.send(hello.worker, self._welcome)

    def _admit(self, ready: Ready) -> None:
        if ready.worker not in self.roster or ready.generation != self._welcome.generation:
            return
        objection = self.roster.admit(ready)
        if objection:
            self._expel(ready.worker, objection)
            return
        taken = self._leases.join(ready.worker)
        log.info("worker %s joined, %d in the run", ready.worker, self.num_workers)
        if self._round is not None:
            self._ask(ready.worker, taken)

    def _lose(self, worker: str, why: str) -> None:
        self.roster.forget(worker)
        self._busy.pop(worker, None)
        if worker not in self._leases.workers:
            return
        heirs = self._leases.leave(worker)
        log.info("worker %s left: %s; %d in the run", worker, why, self.num_workers)
        if self._round is not None:
            for heir, slots in heirs.items():
                self._ask(heir, slots)

    def _expel(self, worker: str, reason: str) -> None:
        log.warning("%s; it is sent away", reason)
        self._link.send(worker, Stop(reason=reason, final=True))
        self._lose(worker, "it was sent away")

    def _fail(self, failure: Failure) -> None:
        """An environment failed: the same would happen on every other worker."""
        known = failure.worker in self.roster
        if not known or failure.generation != self._welcome.generation:
            return
        if not failure.usage:
            raise RunFailedError(f"{failure.reason}; {self.roster.describe(failure.worker)}")
        if self.roster.first is None:
            raise UsageError(failure.reason)
        self._expel(failure.worker, f"{self.roster.describe(failure.worker)}: {failure.reason}")

    # questions and answers

    def _ask(self, worker: str, slots: tuple[int, ...]) -> None:
        """Put the present question to a worker, for those of `slots` that have not answered."""
        assert self._task is not None
        assert self._round is not None
        assert self._collect is not None
        missing = set(self._round.missing)
        wanted = tuple(slot for slot in slots if slot in missing)
        busy = self._busy.get(worker)
        if not wanted or (busy is not None and busy.slots and busy.id != self._round.id):
            return  # a late worker is asked again when it has answered
        lacking = tuple(slot for slot in wanted if slot not in self._leases.current)
        for slot in lacking:
            if slot in self._snapshots:
                self._link.send(
                    worker,
                    Restore(
                        generation=self._welcome.generation,
                        iteration=self._collect.iteration,
                        slot=slot,
                        snapshot=self._snapshots[slot],
                    ),
                )
        if lacking and not isinstance(self._task, Collect):
            self._link.send(worker, replace(self._collect, slots=lacking))
        self._link.send(worker, replace(self._task, slots=wanted))
        owed = busy.slots if busy is not None else set()
        self._busy[worker] = _Busy(self._round.id, owed | set(wanted))

    def _take(self, answer: Answer) -> None:
        first, size = block_of(answer)
        aligned = size > 0 and size & (size - 1) == 0 and first % size == 0
        if not aligned or answer.worker not in self.roster:
            return
        round_id = RoundId(answer.generation, answer.iteration, answer.round)
        self._settle(answer, round_id, range(first, first + min(size, self._leases.num_slots)))
        if self._round is None or self._task is None or round_id != self._round.id:
            return
        if not isinstance(answer, _ANSWER_TO[type(self._task)]):
            return
        if not self._sound(answer):
            return
        self._round.offer(round_id, (first, size), answer)

    def _settle(self, answer: Answer, round_id: RoundId, slots: range) -> None:
        """Note what the answer says about its sender, whether or not it still counts."""
        if isinstance(answer, Collected) and self._is_present(answer):
            self._leases.mark_current(answer.slot, answer.worker)
            self._note_exactness(answer)
        busy = self._busy.get(answer.worker)
        if busy is None or busy.id != round_id:
            return
        busy.slots.difference_update(slots)
        late = self._round is not None and busy.id != self._round.id
        if late and not busy.slots and answer.worker in self._leases.workers:
            del self._busy[answer.worker]
            self._ask(answer.worker, self._leases.slots_of(answer.worker))

    def _note_exactness(self, answer: Collected) -> None:
        if self.exact and not answer.exact:
            self.exact = False
            log.warning("slot %d lost its state in a move: the run is not exact", answer.slot)

    def _is_present(self, answer: Collected) -> bool:
        """Was it collected in the present iteration?"""
        collect = self._collect
        return (
            collect is not None
            and answer.generation == collect.generation
            and answer.iteration == collect.iteration
        )

    def _sound(self, answer: Answer) -> bool:
        """Sizes as the config says, numbers finite; a worker that breaks either is dealt with."""
        assert self.roster.first is not None
        spaces, count = spaces_in(self.roster.first), self._parameter_count()
        if objection := shape_objection(answer, spaces, count):
            self._expel(answer.worker, f"{self.roster.describe(answer.worker)} {objection}")
            return False
        if not is_finite(answer):
            first, size = block_of(answer)
            raise RunFailedError(
                f"slots {first} to {first + size - 1} on {self.roster.describe(answer.worker)} "
                f"sent a {type(answer).__name__} that is not finite, iteration "
                f"{answer.iteration}, round {answer.round}; lower --learning-rate or look at the "
                "rewards' scale"
            )
        return True

    def _waiting_for(self) -> str:
        """Who keeps us waiting, in words."""
        assert self._round is not None
        missing = self._round.missing
        if not self._leases.workers:
            return f"iteration {self._round.id.iteration}: waiting for any worker"
        holders = sorted({self._leases.holder.get(slot, "nobody") for slot in missing})
        here = self._round.id
        return (
            f"iteration {here.iteration}, round {here.round}: waiting for slots {list(missing)} "
            f"of {', '.join(holders)}"
        )
