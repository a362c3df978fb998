"""Asks all slots something and gathers the answers, whoever holds them, whatever dies meanwhile.

The rules are in `dppo.rounds` and `dppo.leases`; this file feeds them with what arrives and
carries out what they say. A worker that is lost costs one redo of its slots (`questions.py`).
"""

import logging
import time
from collections.abc import Callable
from math import isfinite

from dppo.deadlines import Deadlines
from dppo.errors import RunFailedError
from dppo.leases import Leases
from dppo.patience import Patience
from dppo.quarantine import Quarantine
from dppo.rounds import Round, RoundId
from dppo.spaces import Spaces
from dppo.watch import Watch
from dppo.wire.links import LearnerLink, Refused, WorkerLost
from dppo.wire.messages import (
    Alive,
    Answer,
    Collect,
    Collected,
    Failure,
    Gradient,
    Hello,
    Measure,
    Measured,
    Ready,
    Stop,
    Task,
    ToLearner,
    Welcome,
)
from learner.meanwhile import Meanwhile
from learner.members import Members, listed
from learner.questions import Questions
from learner.roster import Roster, spaces_in
from learner.soundness import Expected, block_of, magnitudes

log = logging.getLogger("learner")
_TICK = 0.25
"""Longest wait for one event [s]; children and signals are looked after in between."""
_REMARK_SECONDS = 10.0
_AT_FIRST = 10.0
"""So many times as patient before it is known how long this run's steps take."""


class Exchange:
    """The learner's side of every round."""

    def __init__(
        self,
        link: LearnerLink,
        welcome: Welcome,
        leases: Leases,
        look_after: Callable[[], None],
        patience: float = 3.0,
        clock: Callable[[], float] = time.monotonic,
        deadlines: Deadlines | None = None,
    ) -> None:
        """Nobody has joined yet.

        Args:
            link: the learner's end of the wire.
            welcome: what a worker that joins is told.
            leases: who holds which slot.
            look_after: called in every pause; it may raise to end the run.
            patience: the least time that a worker may make no progress, or be silent [s].
            clock: seconds since some moment.
            deadlines: of updates that may go on without some slots; None: all wait for all.
        """
        self._link, self._welcome, self._leases = link, welcome, leases
        self._look_after = look_after
        self._questions = Questions(link, leases)
        self._clock = clock
        watch = Watch(
            patience=Patience(first=_AT_FIRST * patience, least=patience),
            pulse=Patience(first=patience, least=patience),
        )
        self._members = Members(link, welcome, leases, self._questions, watch, clock)
        self._quarantine = Quarantine()
        self._iteration, self._looked = 0, clock()
        self.expected: Expected | None = None
        """The form of answers; to be set before the first question."""
        self.exact = True
        """No slot has lost a bit on a move."""
        self._deadlines = deadlines or Deadlines(leases.num_slots, drop_limit=0)
        self.meanwhile = Meanwhile()
        """What is done when the next question has been put."""

    @property
    def roster(self) -> Roster:
        """Who has said Hello."""
        return self._members.roster

    @property
    def num_workers(self) -> int:
        """Workers in the run now."""
        return len(self._leases.workers)

    def wait_for_environment(self) -> Spaces:
        """Wait until a worker has built the environment; its sizes."""
        begun = remarked = self._clock()
        while self.roster.first is None:
            self._handle(_TICK)
            if self._clock() - remarked > _REMARK_SECONDS:
                remarked = self._clock()
                log.warning("waiting for a first worker, for %.0f s", remarked - begun)
        return spaces_in(self.roster.first)

    def begin_iteration(self, collect: Collect, snapshots: dict[int, bytes]) -> None:
        """Spread the slots anew; remember what a lost slot has to be started from."""
        self._questions.begin_iteration(collect, snapshots)
        self._iteration = collect.iteration
        self._leases.seconds = self._members.pace.seconds_per_slot
        self._leases.spread()
        for spare in self._leases.spares:
            self._members.pace.stand_by(spare)
        if self._leases.spares and collect.iteration % 100 == 1:
            log.warning("%s", self._members.standing_by())

    def gather(self, task: Task, quorum: int) -> Round[Answer]:
        """Ask all slots, wait until the round may close, take what else is there; the round."""
        round_ = self._questions.open(task, quorum)
        self._members.asked(type(task))
        asked = self._clock()
        self.meanwhile.do()
        self._pause()
        begun = remarked = self._clock()
        deadline = self._deadlines.open(round_, begun)
        if isinstance(task, Collect):
            for worker in set(self._leases.holder.values()):
                self._members.pace.begin(worker, self._leases.slots_of(worker), asked)
        while not round_.may_close:
            left = deadline - self._clock()
            self._handle(min(_TICK, left) if left > 0 else _TICK)
            round_.overdue = self._clock() >= deadline
            if self._clock() - remarked > _REMARK_SECONDS:
                remarked = self._clock()
                log.warning("%s, for %.0f s", self.waiting(), remarked - begun)
        while round_.missing and self._handle(0.0):
            pass
        self._deadlines.close(round_, self._clock())
        self._questions.close()
        self._members.answered(type(task))
        return round_

    def stop(self, reason: str, final: bool) -> None:
        """Tell every worker that the run is over, or that this learner pauses."""
        for worker in self.roster:
            self._link.send(worker, Stop(reason=reason, final=final))

    def _handle(self, timeout: float) -> bool:
        """One event, or one silence; was it an event?"""
        event = self._link.receive(timeout)
        self._members.look()
        if event is None or self._clock() - self._looked > _TICK:
            self._pause()
        if event is not None:
            self._attend(event)
        return event is not None

    def _pause(self) -> None:
        """Look after children and signals."""
        self._look_after()
        self._looked = self._clock()

    def _attend(self, event: ToLearner | WorkerLost | Refused) -> None:
        match event:
            case Hello():
                self._members.greet(event)
            case Ready():
                self._members.admit(event)
            case Alive():
                self._members.hear(event.worker, event.done)
            case Collected() | Gradient() | Measured():
                self._take(event)
            case WorkerLost():
                self._members.lose(event.worker, "its connection is gone")
            case Failure():
                self._fail(event)
            case Refused():
                log.warning("ignored a message: %s", event.reason)

    def _fail(self, failure: Failure) -> None:
        """An environment failed; if it fails elsewhere, too, the run cannot go on.

        Raises:
            RunFailedError: it is the second time, for the same slot in the same iteration.
            UsageError: the environment cannot be made.
        """
        worker = failure.worker
        if worker not in self.roster or failure.generation != self._welcome.generation:
            return
        if failure.usage:
            self._members.refuse_setup(worker, failure.reason)
            return
        reason = f"{failure.reason}; {self.roster.describe(worker)}"
        iteration = RoundId(failure.generation, self._iteration, 0)
        before = self._quarantine.fail(worker, failure.slot, iteration)
        if before is not None:
            raise RunFailedError(f"{reason}; it is the second time, after worker {before}")
        log.warning("%s; it is tried once more, elsewhere if there is another worker", reason)
        self._members.part(worker, "one of its environments failed")

    def _take(self, answer: Answer) -> None:
        first, size = block_of(answer)
        fits = 0 <= first < self._leases.num_slots and 0 < size <= self._leases.num_slots
        aligned = fits and size & (size - 1) == 0 and first % size == 0
        if not aligned or not self._members.hear(answer.worker):
            return
        round_id = RoundId(answer.generation, answer.iteration, answer.round)
        was_owed = self._questions.settle(answer, round_id)
        if was_owed:
            self._deadlines.answered(round_id, (first, size), self._clock())
        if isinstance(answer, Collected):
            self._note_exactness(answer)
        round_, task = self._questions.round, self._questions.task
        if round_ is None or round_id != round_.id or task is None or not was_owed:
            return
        if isinstance(task, Collect) and not self._questions.owes(answer.worker):
            self._members.pace.end(answer.worker, self._clock())
        if self._is_sound(answer, round_id):
            round_.offer(round_id, (first, size), answer)

    def _note_exactness(self, answer: Collected) -> None:
        if self.exact and not answer.exact:
            self.exact = False
            log.warning("slot %d lost its state in a move: the run is not exact", answer.slot)

    def _is_sound(self, answer: Answer, round_id: RoundId) -> bool:
        """Lengths as the settings say, numbers finite and not wild; or its worker has to answer
        for it.
        """
        assert self.expected is not None
        if objection := self.expected.objection(answer):
            who = self.roster.describe(answer.worker)
            self._members.expel(answer.worker, f"{who} {objection}")
            return False
        first, size = block_of(answer)
        slots = range(first, min(first + size, self._leases.num_slots))
        found = magnitudes(answer)
        finite = all(map(isfinite, found.values()))
        doubt = self._quarantine.outlier(found) if finite else "numbers that are not finite"
        if doubt:
            if not self._is_confirmed(answer, slots, round_id, doubt, finite):
                return False
            self._quarantine.confirm(found, slots, round_id)
        for worker in self._quarantine.accept(found, slots, round_id):
            self._members.bench(worker)
        return True

    def _is_confirmed(
        self, answer: Answer, slots: range, round_id: RoundId, doubt: str, finite: bool
    ) -> bool:
        """A doubtful answer counts when it has come out so twice.

        Raises:
            RunFailedError: it has, and it is not finite.
        """
        worker = answer.worker
        what = (
            f"slots {listed(slots)} on {self.roster.describe(worker)}: {type(answer).__name__} of "
            f"iteration {answer.iteration}, round {answer.round} with {doubt}"
        )
        before = self._quarantine.refuse(worker, slots, round_id)
        if before is None:
            log.warning("refused %s; it is computed again", what)
            self._members.part(worker, "its answer was refused")
            return False
        if not finite:
            raise RunFailedError(
                f"{what}, the second time after worker {before}; lower --learning-rate or look "
                "at the rewards' scale"
            )
        log.warning("%s, the second time after worker %s: it counts", what, before)
        return True

    def waiting(self) -> str:
        """Who keeps us waiting, in words; empty between two questions."""
        round_ = self._questions.round
        if round_ is None:
            return ""
        kinds: dict[object, str] = {Collect: "collection", Measure: "measurement"}
        where = kinds.get(type(self._questions.task), f"update {round_.id.round}")
        have = tuple(sorted(set(round_.slots) - set(round_.missing)))
        return (
            f"iteration {round_.id.iteration}, {where}: have slots {listed(have)}; "
            f"{self._members.waiting_for(round_.missing)}"
        )
