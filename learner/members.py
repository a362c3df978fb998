"""Who takes part: workers join, are watched, and leave; their slots go to others at once."""

import logging
from collections import Counter
from collections.abc import Callable

from dppo.errors import RunFailedError, UsageError
from dppo.leases import Leases
from dppo.pace import Pace
from dppo.watch import Watch
from dppo.wire.links import LearnerLink
from dppo.wire.messages import VERSION, Hello, Ready, Stop, Task, Welcome
from learner.fencing import check_served
from learner.questions import Questions
from learner.roster import Roster, introduced

log = logging.getLogger("learner")
_LOOK_SECONDS = 0.25
_TOLD_SECONDS = 3.0
"""How often somebody unknown is told to join anew; it may hang, and not hear it."""
_MOST_LOSSES = 30
"""Holders that one slot may lose over one question; one that joins anew counts once."""
_MOST_STALLS = 5
"""Holders of one slot that may be given up over one question; each is waited for twice as long."""


class Members:
    """The workers of this learner."""

    def __init__(
        self,
        link: LearnerLink,
        welcome: Welcome,
        leases: Leases,
        questions: Questions,
        watch: Watch,
        clock: Callable[[], float],
    ) -> None:
        self._link, self._welcome, self._leases = link, welcome, leases
        self._questions, self._watch, self._clock = questions, watch, clock
        self.roster, self.pace = Roster(), Pace()
        self._listened, self._listened_until = 0.0, clock()
        """Seconds that this learner has listened: while it was stopped, nobody was silent."""
        self._look_again = 0.0
        self._losses: dict[int, set[str]] = {}
        self._stalls: Counter[int] = Counter()
        self._known: set[type[Task]] = set()
        self._told: dict[str, float] = {}
        self._benched: set[str] = set()

    def look(self) -> None:
        """Give up who stalls; to be called at least as often as anything is received.

        Raises:
            RunFailedError: as `lose`, or a slot stalls wherever it is.
        """
        now = self._clock()
        self._listened += min(now - self._listened_until, 2 * _LOOK_SECONDS)
        self._listened_until = now
        if self._listened < self._look_again:
            return
        self._look_again = self._listened + _LOOK_SECONDS
        owing = [worker for worker in self._leases.workers if self._questions.owes(worker)]
        if stalled := self._watch.look(self._listened, owing):
            self._give_up(stalled)

    def _give_up(self, stalled: list[str]) -> None:
        """All at once: none of them is an heir of another."""
        held: list[int] = []
        for worker in stalled:
            why = self._watch.describe(worker, self._listened)
            who, slots = self.roster.describe(worker), self._leases.slots_of(worker)
            held += slots
            log.warning("%s stalls: %s; others take its slots %s", who, why, listed(slots))
            self._link.send(worker, Stop(reason=f"it was given up, {why}", final=False))
            self._link.cut(worker)
        self._stalls.update(held)
        if worst := [slot for slot in sorted(held) if self._stalls[slot] > _MOST_STALLS]:
            raise RunFailedError(
                f"slots {listed(tuple(worst))} stall on worker after worker, the last one was "
                f"{who}, {why}; look what their environments wait for, or give a larger --patience"
            )
        self._lose_all(stalled, "it was given up")

    def hear(self, worker: str, done: int | None = None) -> bool:
        """Something came from a worker; is it one of us? One that is not has to join anew."""
        if worker in self._leases.workers:
            self._watch.hear(worker, self._listened, done)
            return True
        if done is not None and self._listened - self._told.get(worker, -1e9) > _TOLD_SECONDS:
            self._told[worker] = self._listened
            self._link.send(worker, Stop(reason="the learner does not know it", final=False))
        return worker in self.roster

    def asked(self, kind: type[Task]) -> None:
        """A question of this kind is put."""
        self._watch.is_new = kind not in self._known

    def answered(self, kind: type[Task]) -> None:
        """It was answered: what happened on the way is over."""
        self._known.add(kind)
        self._losses.clear()
        self._stalls.clear()
        self._watch.calm()

    def bench(self, worker: str) -> None:
        """Others found otherwise what a worker had answered, again and again."""
        self._benched.add(worker)
        if worker in self.roster:
            self.expel(worker, f"{self.roster.describe(worker)} was refused again and again")

    def greet(self, hello: Hello) -> None:
        """A worker asks to join.

        Raises:
            SupersededError: it has served a later learner of this run.
        """
        if hello.protocol != VERSION:  # it understands a Stop, and nothing else of ours
            self.expel(
                hello.worker,
                f"{introduced(hello)} speaks protocol version {hello.protocol}, the learner "
                f"speaks {VERSION}; install the same dppo on both",
            )
            return
        check_served(hello, self._welcome)
        self._told.pop(hello.worker, None)
        if hello.worker in self._leases.workers:
            self.lose(hello.worker, "it joins anew")
        self.roster.greet(hello)
        if hello.worker in self._benched:
            self.bench(hello.worker)
            return
        self._link.send(hello.worker, self._welcome)

    def admit(self, ready: Ready) -> None:
        """A worker has built the environment: it takes over what nobody holds."""
        if ready.worker not in self.roster or ready.generation != self._welcome.generation:
            return
        objection = self.roster.admit(ready)
        if objection:
            self.expel(ready.worker, objection)
            return
        taken = self._leases.join(ready.worker)
        log.info("worker %s joined, %d in the run", ready.worker, len(self._leases.workers))
        self._questions.ask(ready.worker, taken)

    def lose(self, worker: str, why: str) -> None:
        """A worker is gone: its slots go to others.

        Raises:
            RunFailedError: one slot has lost holder after holder over the same question.
        """
        self._lose_all([worker], why)

    def _lose_all(self, gone: list[str], why: str) -> None:
        lost = [worker for worker in gone if worker in self._leases.workers]
        held = tuple(slot for worker in lost for slot in self._leases.slots_of(worker))
        heirs = self._leases.leave(*lost)
        for worker in gone:
            self.roster.forget(worker)
            self._questions.forget(worker)
            self._watch.forget(worker)
            self.pace.forget(worker)
        for worker in lost:
            log.info("worker %s left: %s; %d in the run", worker, why, len(self._leases.workers))
        for slot in held:
            self._losses.setdefault(slot, set()).update(lost)
        if any(len(self._losses[slot]) > _MOST_LOSSES for slot in held):
            raise RunFailedError(
                f"slots {listed(held)} have lost more than {_MOST_LOSSES} workers in a row, the "
                f"last one was {gone[-1]}: {why}; see what the workers printed"
            )
        for heir, slots in heirs.items():
            self.pace.spoil(heir)
            self._questions.ask(heir, slots)

    def part(self, worker: str, why: str) -> None:
        """Take a worker's slots away; it may join anew."""
        self._link.send(worker, Stop(reason=why, final=False))
        self.lose(worker, why)

    def expel(self, worker: str, reason: str) -> None:
        """Send a worker away for good."""
        log.warning("%s; it is sent away", reason)
        self._link.send(worker, Stop(reason=reason, final=True, sent_away=True))
        self.lose(worker, "it was sent away")

    def refuse_setup(self, worker: str, reason: str) -> None:
        """A worker cannot make the environment: on the first one it is the settings' fault.

        Raises:
            UsageError: no worker has managed it yet.
        """
        if self.roster.first is None:
            raise UsageError(reason)
        self.expel(worker, f"{self.roster.describe(worker)}: {reason}")

    def standing_by(self) -> str:
        """Who holds no slot, and why, in words."""
        spares, slots = self._leases.spares, self._leases.num_slots
        if len(self._leases.workers) > slots:
            return f"{len(spares)} workers stand by: --slots {slots} is what limits them"
        who = ", ".join(map(self.roster.describe, spares))
        return f"these stand by, the others are done sooner without them: {who}"

    def waiting_for(self, missing: tuple[int, ...]) -> str:
        """Who keeps us waiting for these slots, in words."""
        if not self._leases.workers:
            return f"waiting for any worker, for slots {listed(missing)}"
        parts = []
        for worker in self._leases.workers:
            held = tuple(slot for slot in self._leases.slots_of(worker) if slot in missing)
            if held:
                silence = self._watch.describe(worker, self._listened)
                parts.append(f"{self.roster.describe(worker)} (slots {listed(held)}), {silence}")
        return f"waiting for {'; '.join(parts)}"


def listed(slots: tuple[int, ...] | range) -> str:
    """Slots in words: 0-5, 7; none."""
    runs: list[list[int]] = []
    for slot in slots:
        if runs and runs[-1][-1] == slot - 1:
            runs[-1][1:] = [slot]
        else:
            runs.append([slot])
    return ", ".join("-".join(map(str, run)) for run in runs) or "none"
