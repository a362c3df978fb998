"""Asks all slots something and gathers the answers, whoever holds them, whatever dies meanwhile.

The rules are in `dppo.rounds` and `dppo.leases`; this file feeds them with what arrives and
carries out what they say. A worker that is lost costs one redo of its slots (`questions.py`).
"""

import logging
import re
import time
from collections.abc import Callable

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
    Stop,
    Task,
    Update,
    Welcome,
)
from learner.fencing import check_served
from learner.questions import Questions
from learner.roster import Roster, spaces_in
from learner.soundness import block_of, is_finite, shape_objection

log = logging.getLogger("learner")
_TICK = 0.25
"""Longest wait for one event [s]; children and signals are looked after in between."""
_REMARK_SECONDS = 10.0
_ANSWER_TO = {Collect: Collected, Update: Gradient, Measure: Measured}


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
        self._questions = Questions(link, leases)

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
        self._questions.begin_iteration(collect, snapshots)
        self._leases.spread()
        if self._leases.spares and collect.iteration % 100 == 1:
            spares, slots = len(self._leases.spares), self._leases.num_slots
            log.warning("%d workers stand by: --slots %d is what limits them", spares, slots)

    def gather(self, task: Task, quorum: int) -> Round[Answer]:
        """Ask all slots, wait until the quorum is in, take what else is there; the round."""
        self._look_after()
        round_ = self._questions.open(task, quorum)
        begun = remarked = time.monotonic()
        while not round_.may_close:
            self._handle(_TICK)
            if time.monotonic() - remarked > _REMARK_SECONDS:
                remarked = time.monotonic()
                log.warning("%s, for %.0f s", self._waiting_for(round_), remarked - begun)
        while round_.missing and self._handle(0.0):
            pass
        self._questions.close()
        return round_

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
        check_served(hello, self._welcome)
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
        self._questions.ask(ready.worker, taken)

    def _lose(self, worker: str, why: str) -> None:
        self.roster.forget(worker)
        self._questions.forget(worker)
        if worker not in self._leases.workers:
            return
        heirs = self._leases.leave(worker)
        log.info("worker %s left: %s; %d in the run", worker, why, self.num_workers)
        for heir, slots in heirs.items():
            self._questions.ask(heir, slots)

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

    def _take(self, answer: Answer) -> None:
        first, size = block_of(answer)
        aligned = size > 0 and size & (size - 1) == 0 and first % size == 0
        if not aligned or answer.worker not in self.roster:
            return
        round_id = RoundId(answer.generation, answer.iteration, answer.round)
        self._questions.settle(answer, round_id)
        if isinstance(answer, Collected):
            self._note_exactness(answer)
        round_, task = self._questions.round, self._questions.task
        if round_ is None or round_id != round_.id or task is None:
            return
        if isinstance(answer, _ANSWER_TO[type(task)]) and self._sound(answer):
            round_.offer(round_id, (first, size), answer)

    def _note_exactness(self, answer: Collected) -> None:
        if self.exact and not answer.exact:
            self.exact = False
            log.warning("slot %d lost its state in a move: the run is not exact", answer.slot)

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

    def _waiting_for(self, round_: Round[Answer]) -> str:
        """Who keeps us waiting, in words."""
        here, missing = round_.id, round_.missing
        if not self._leases.workers:
            return f"iteration {here.iteration}: waiting for any worker"
        holders = sorted({self._leases.holder.get(slot, "nobody") for slot in missing})
        return (
            f"iteration {here.iteration}, round {here.round}: waiting for slots {list(missing)} "
            f"of {', '.join(holders)}"
        )
