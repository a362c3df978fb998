"""A learner's exchange, and workers played by hand.

What they say lies in the queue before the learner reads it, so a story has one order of events.
Its clock only moves in silences.
"""

from dataclasses import replace

import numpy as np
from safetensors.numpy import save

from dppo.deadlines import Deadlines
from dppo.leases import Leases
from dppo.spaces import Spaces
from dppo.wire import messages as wire
from dppo.wire.memory_links import MemoryHub
from learner.exchange import Exchange
from learner.soundness import Expected

SLOTS, PARAMETERS, OBS, SAMPLES, ALL = 4, 3, 2, 64, (0, 1, 2, 3)
AFTER = save({"state": np.arange(3.0)})
CATCHING_UP = ["Restore 0", "Restore 1", "Collect (0, 1)", "Update (0, 1)"]
BEFORE = dict.fromkeys(ALL, b"before")
ONES = np.ones(PARAMETERS, np.float32)
WELCOME = wire.Welcome(run="3f9c", generation=7, config="{}")
HELLO = wire.Hello(worker="", host="lab1", pid=12, numerics="9c1e", versions="mujoco 4")
READY = wire.Ready(
    worker="", generation=7, obs_size=OBS, action_kind="box", action_sizes=(1,), env_hash="5d41",
    exact="captured",
)  # fmt: skip
FAILURE = wire.Failure(
    worker="", generation=7, usage=False, slot=3, reason="slot 3: reward is nan"
)
ALIVE = wire.Alive(worker="", generation=7, done=0)
COLLECTED = wire.Collected(
    worker="", generation=7, iteration=1, round=0, slot=0, obs=np.zeros(1 + 2 * OBS),
    returns=np.zeros(3), advantages=np.zeros(7), fit=np.zeros(7), sigma_target=np.zeros(3),
    reward=np.zeros(3), start_sigma=np.zeros(3), episodes=np.zeros(0), exact=True, snapshot=AFTER,
)  # fmt: skip
GRADIENT = wire.Gradient(
    worker="", generation=7, iteration=1, round=1, first=0, size=1, stopped=(), vector=ONES,
    sums=np.zeros(7),
)  # fmt: skip
MEASURED = wire.Measured(
    worker="", generation=7, iteration=1, round=3, first=0, size=1, kls=np.zeros(1),
    weights=np.ones(1),
)  # fmt: skip
COLLECT = wire.Collect(
    generation=7, iteration=1, round=0, slots=ALL, psi=0.1, beta=1.0, mean_reward=2.5,
    parameters=ONES, obs=np.zeros(1 + 2 * OBS), returns=np.zeros(3), sigma_target=np.zeros(3),
)  # fmt: skip
UPDATE = wire.Update(
    generation=7, iteration=1, round=1, slots=ALL, stopped=(), parameters=ONES,
    advantages=np.zeros(7),
)  # fmt: skip
MEASURE = wire.Measure(generation=7, iteration=1, round=3, slots=ALL, parameters=ONES)


SPACES = Spaces(obs_size=OBS, action_kind="box", action_sizes=(1,))


class NobodySpeaksError(Exception):
    """The learner waits, and the story is over."""


class Player:
    """A worker, played by hand."""

    def __init__(self, name, hub):
        self.name, self.link = name, hub.worker(name)

    def say(self, message, **facts):
        self.link.send(replace(message, worker=self.name, **facts))

    def join(self, **facts):
        self.say(HELLO)
        self.say(READY, **facts)
        return self

    def collected(self, *slots, **facts):
        for slot in slots:
            self.say(COLLECTED, slot=slot, **facts)

    def gradient(self, first, size, **facts):
        self.say(GRADIENT, first=first, size=size, **facts)

    def heard(self):
        """What has arrived since the last look, in words: `Collect (0, 1)`, `Restore 3`."""
        words = []
        while (message := self.link.receive(0.0)) is not None:
            about = getattr(message, "slots", getattr(message, "slot", ""))
            words.append(f"{type(message).__name__} {about}".strip())
            self.last = message
        return words


class _Prompt:
    """A learner's end on which a silence takes no time: nobody speaks beside the story."""

    def __init__(self, link):
        self.send, self.cut, self.close = link.send, link.cut, link.close
        self.receive = lambda _timeout: link.receive(0.0)


class Story:
    """An exchange and the workers it talks to; with names, these have been through iteration 0."""

    def __init__(self, *names, patience=1.0):
        self.hub, self.pauses, self.silences, self.now = MemoryHub(), 0, 1, 0.0
        self.then = {}
        self.deadlines = Deadlines(SLOTS, drop_limit=3)
        self.exchange = Exchange(
            _Prompt(self.hub.learner()),
            WELCOME,
            Leases(SLOTS),
            self.look_after,
            patience,
            lambda: self.now,
            self.deadlines,
        )
        self.exchange.expected = Expected(SPACES, PARAMETERS, SAMPLES)
        self.players = [Player(name, self.hub).join() for name in names]
        if names:
            self.players[0].collected(*ALL, iteration=0)
            self.exchange.wait_for_environment()
            self.collect(replace(COLLECT, iteration=0), {})
        for player in self.players:
            player.heard()

    def look_after(self):
        """Called at the start of every question, and in every silence of a quarter of a second."""
        self.pauses += 1
        if self.pauses > self.silences:
            raise NobodySpeaksError
        if self.pauses > 1:
            self.now += 0.25
            self.then.pop(self.pauses - 1, lambda: None)()

    def silent(self, silences, **then):
        """Let so many silences pass; `after_2=act` acts in the second one."""
        self.silences = 1 + silences
        self.then = {int(when.split("_")[1]): act for when, act in then.items()}

    def ask(self, task, quorum=SLOTS):
        self.pauses = 0
        return self.exchange.gather(task, quorum)

    def collect(self, task=COLLECT, snapshots=BEFORE):
        self.exchange.begin_iteration(task, snapshots)
        return self.ask(task)


def two_that_have_collected():
    """Iteration 1, round 0 is over: w1 holds slots 0 and 1, w2 holds 2 and 3."""
    story = Story("w1", "w2")
    one, two = story.players
    one.collected(0, 1)
    two.collected(2, 3)
    story.collect()
    assert one.heard() == ["Collect (0, 1)"]
    assert two.heard() == ["Restore 2", "Restore 3", "Collect (2, 3)"]  # they were with w1
    return story, one, two
