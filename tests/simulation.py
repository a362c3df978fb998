"""A learner's exchange among simulated workers: any order of events, one thread, no clock.

The learner waits by calling `receive`; there, what happens next is chosen: a message arrives, a
worker works, stalls, wakes, dies or joins, an old message comes again, a quarter of a second
passes. When the choices are used up the world is fair: whoever does not hang works, all arrives.

Numbers are such that any mistake shows: a gradient is a function of its slot, iteration, round and
of the parameters it was computed from.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from safetensors.numpy import save

from dppo.sums import aligned_blocks, members, sum_rows
from dppo.wire import messages as wire
from dppo.wire.links import LearnerLost, WorkerLost

SLOTS, OBS, SAMPLES, SIZE = 5, 2, 64, 2
ALL = tuple(range(SLOTS))
MOST_WORKERS = 4
FAIR_STEPS = 20_000
"""More than any wait may take once the world is fair."""


class WaitNeverEndsError(Exception):
    """The world is fair, and the learner waits all the same."""


def gradient_of(slot, iteration, round_, parameters):
    """[SIZE] exact in float32: small whole numbers."""
    return np.array([slot + 8 * iteration + 64 * round_, 1], np.float32) + np.round(
        parameters % 97
    )


def snapshot_of(slot, iteration):
    return save({"at": np.array([slot, iteration])})


@dataclass
class Worker:
    """One process, as `workers.membership` and `workers.worker` behave."""

    name: str
    up: list[Any] = field(default_factory=list)
    """What it has said and has not arrived."""
    inbox: list[Any] = field(default_factory=list)
    joined: bool = False
    hangs: bool = False
    lies: bool = False
    done: int = 0
    boundary: dict[int, int] = field(default_factory=dict)
    experience: set[Any] = field(default_factory=set)

    def say(self, kind, **fields):
        self.up.append(kind(worker=self.name, **fields))

    def hello(self):
        self.joined = False
        self.boundary, self.experience = {}, set()
        self.say(wire.Hello, host="h", pid=1, numerics="n", versions="v")

    def work(self):
        """Take one message; without any, knock again or show that it lives. False: it ends."""
        self.done += 1
        if not self.inbox:
            if self.joined:
                self.say(wire.Alive, generation=1, done=self.done)
            else:
                self.hello()
            return True
        message = self.inbox.pop(0)
        if isinstance(message, wire.Stop) and message.final:
            return False
        if not self.joined:
            if isinstance(message, wire.Welcome):
                self.joined = True
                self.say(
                    wire.Ready, generation=1, obs_size=OBS, action_kind="box", action_sizes=(1,),
                    env_hash="", exact="captured",
                )  # fmt: skip
        elif isinstance(message, wire.Stop | LearnerLost):
            self.hello()
        elif not isinstance(message, wire.Welcome):
            self.perform(message)
        return True

    def perform(self, task):
        match task:
            case wire.Restore():
                self.boundary[task.slot] = task.iteration
            case wire.Collect():
                ready = task.iteration == 0 or all(
                    self.boundary.get(slot) == task.iteration for slot in task.slots
                )
                self.collect(task) if ready else self.hello()
            case _:
                ready = all((slot, task.iteration) in self.experience for slot in task.slots)
                self.answer(task) if ready else self.hello()

    def collect(self, task):
        for slot in task.slots:
            self.experience.add((slot, task.iteration))
            self.boundary[slot] = task.iteration + 1
            one = np.array([1.0, 1.0, 0.0])
            self.say(
                wire.Collected, generation=1, iteration=task.iteration, round=0, slot=slot,
                obs=np.zeros(1 + 2 * OBS), returns=one, advantages=np.zeros(7), fit=np.zeros(7),
                sigma_target=one, reward=one, start_sigma=one, episodes=np.zeros(0), exact=True,
                snapshot=snapshot_of(slot, task.iteration + 1),
            )  # fmt: skip

    def answer(self, task):
        where = {"generation": 1, "iteration": task.iteration, "round": task.round}
        if isinstance(task, wire.Measure):
            for first, size in aligned_blocks(task.slots):
                kls = np.array([float(slot) for slot in members((first, size))])
                self.say(
                    wire.Measured, **where, first=first, size=size, kls=kls, weights=np.ones(size)
                )
            return
        for first, size in aligned_blocks(task.slots):
            rows = [
                gradient_of(slot, task.iteration, task.round, task.parameters)
                for slot in members((first, size))
            ]
            vector = sum_rows(np.stack(rows))
            if self.lies:
                self.lies, vector = False, np.full(SIZE, np.nan, np.float32)
            self.say(
                wire.Gradient, **where, first=first, size=size, stopped=(), vector=vector,
                sums=np.array([1.0, 1.0, 0, 0, 0, 0, 0]) * size,
            )  # fmt: skip


class World:
    """The learner's link, and all that is on its other side."""

    def __init__(self, choices, names="abcd"):
        self.choices, self.now, self.fair_steps = list(choices), 0.0, 0
        self.workers, self.lost, self.heard, self.births = {}, [], [], 0
        self.lie_is_told, self.calm = False, 0
        for _ in names[:2]:
            self.start()

    # the learner's end of the wire

    def receive(self, timeout):
        if self.calm > 0:
            self.calm -= 1
            return self.be_fair(timeout)
        if self.choices:
            number, who = divmod(self.choices.pop(0), 16)
            acts = self.acts()
            return acts[number % len(acts)](who)
        self.fair_steps += 1
        if self.fair_steps > FAIR_STEPS:
            raise WaitNeverEndsError
        return self.be_fair(timeout)

    def send(self, worker, message):
        if worker not in self.workers:
            return
        inbox = self.workers[worker].inbox
        inbox.append(message)
        questions = [each for each in inbox if isinstance(each, wire.Update | wire.Measure)]
        rounds = {(each.iteration, each.round) for each in questions}
        assert len(rounds) <= 1, "more than one question is under way to a worker"

    def cut(self, worker):
        pass

    def close(self):
        pass

    # what may happen

    def acts(self):
        return (
            self.deliver, self.work, self.go_on, self.go_on, self.repeat, self.lose, self.kill,
            self.start, self.hang, self.wake, self.lie, self.tick,
        )  # fmt: skip

    def one_of(self, who):
        names = sorted(self.workers)
        return self.workers[names[who % len(names)]] if names else None

    def go_on(self, who):
        """For a while all goes well."""
        self.calm = 3 * who

    def deliver(self, who):
        """The next message of a worker, or the news that one is gone."""
        if self.lost and who % 2:
            return WorkerLost(self.lost.pop(0))
        worker = self.one_of(who)
        if worker is None or not worker.up:
            return None
        self.heard.append(worker.up.pop(0))
        return self.heard[-1]

    def work(self, who):
        worker = self.one_of(who)
        if worker is not None and not worker.hangs and not worker.work():
            self.kill_one(worker)

    def repeat(self, who):
        """An answer that was heard is heard again, however old; a lie is told once."""
        answers = [
            each
            for each in self.heard
            if isinstance(each, wire.Collected | wire.Measured)
            or (isinstance(each, wire.Gradient) and np.isfinite(each.vector).all())
        ]
        return answers[-1 - who % len(answers)] if answers else None

    def lose(self, who):
        """A connection breaks: what was under way is gone, both ends hear of it."""
        worker = self.one_of(who)
        if worker is not None:
            worker.up.clear()
            worker.inbox[:] = [LearnerLost()]
            self.lost.append(worker.name)

    def kill(self, who):
        worker = self.one_of(who)
        if worker is not None:
            self.kill_one(worker)

    def kill_one(self, worker):
        del self.workers[worker.name]
        self.lost.append(worker.name)

    def start(self, _who=0):
        if len(self.workers) < MOST_WORKERS:
            self.births += 1
            worker = Worker(f"w{self.births}")
            self.workers[worker.name] = worker
            worker.hello()

    def hang(self, who):
        """A worker stops, or its environment hangs; it may wake up again."""
        worker = self.one_of(who)
        if worker is not None:
            worker.hangs = True

    def wake(self, who):
        worker = self.one_of(who)
        if worker is not None:
            worker.hangs = False

    def lie(self, who):
        """One gradient of a worker will not be finite; at most one in an iteration."""
        worker = self.one_of(who)
        if worker is not None and not self.lie_is_told:
            worker.lies = self.lie_is_told = True

    def next_iteration(self):
        self.lie_is_told = any(worker.lies for worker in self.workers.values())

    def tick(self, _who=0):
        self.now += 0.25

    def be_fair(self, timeout):
        """Everything that can go on goes on; those that hang, hang for ever."""
        if not any(not worker.hangs for worker in self.workers.values()):
            self.births += 1
            self.workers[f"w{self.births}"] = Worker(f"w{self.births}")
        for worker in list(self.workers.values()):
            if worker.up:
                self.heard.append(worker.up.pop(0))
                return self.heard[-1]
        if self.lost:
            return WorkerLost(self.lost.pop(0))
        for worker in list(self.workers.values()):
            if not worker.hangs and worker.inbox:
                if not worker.work():
                    self.kill_one(worker)
                return None
        self.now += timeout
        for number in range(len(self.workers)):
            self.work(number)
        return None
