"""What a long life brings: many at once, many signs of life, long tasks, losses at bad moments."""

import json
import threading
from dataclasses import replace

import numpy as np
import pytest

import tests.odd_envs  # noqa: F401  registers the environments
from dppo.config import Config, RolloutConfig, RunConfig
from dppo.leases import Leases
from dppo.networks import Networks
from dppo.pace import Pace
from dppo.patience import Patience
from dppo.process import Terminated
from dppo.spaces import Spaces
from dppo.watch import Watch
from dppo.wire import messages as wire
from dppo.wire.memory_links import MemoryHub
from learner.exchange import Exchange
from tests.story import ALIVE, COLLECT, SLOTS, WELCOME, NobodySpeaksError, Player, Story
from workers.membership import Member


def test_workers_that_stall_in_the_same_moment_are_one_stall_of_a_slot():
    slots, story = tuple(range(8)), Story()
    story.exchange._leases.num_slots = len(slots)
    players = [Player(f"w{number}", story.hub).join() for number in slots]
    players[0].collected(*slots, iteration=0)
    story.exchange.wait_for_environment()
    story.collect(replace(COLLECT, iteration=0, slots=slots), {})
    story.silent(11)  # 2.75 s: one second is allowed, then two
    with pytest.raises(NobodySpeaksError):
        story.collect(replace(COLLECT, slots=slots), dict.fromkeys(slots, b"before"))


class Chatter:
    """A learner's end on which somebody always speaks before a quarter of a second is over."""

    def __init__(self, link):
        self.inner, self.now, self.said = link, 0.0, 0
        self.send, self.cut, self.close = link.send, link.cut, link.close

    def receive(self, timeout):
        event = self.inner.receive(0.0)
        if event is not None:
            return event
        self.now, self.said = self.now + 0.1, self.said + 1
        assert self.said < 1000, "100 s without a look at signals and children"
        return replace(ALIVE, worker="w0", done=self.said) if timeout else None


def test_signals_are_looked_after_in_a_long_round_with_many_signs_of_life():
    hub, looks = MemoryHub(), []
    link = Chatter(hub.learner())

    def look_after():
        looks.append(link.now)
        if link.now > 1:
            raise Terminated

    exchange = Exchange(link, WELCOME, Leases(SLOTS), look_after, clock=lambda: link.now)
    Player("w0", hub).join()
    exchange.wait_for_environment()
    exchange.begin_iteration(replace(COLLECT, iteration=0), {})
    with pytest.raises(Terminated):
        exchange.gather(replace(COLLECT, iteration=0), SLOTS)


def test_a_task_that_always_takes_longer_than_a_sign_of_life_is_not_given_up_for_ever():
    watch = Watch(patience=Patience(first=30.0, least=3.0), pulse=Patience(first=3.0, least=3.0))
    now, done, vain = 0.0, 0, []
    for update in range(20):
        for _ in range(8):  # four seconds of steps
            now, done = now + 0.5, done + 1
            watch.hear("w", now, done)
            watch.look(now, ["w"])
        for _ in range(20):  # ten seconds of one gradient
            now += 0.5
            watch.hear("w", now, done)
            if watch.look(now, ["w"]):
                vain.append(update)
        watch.hear("w", now)  # the answer
        watch.calm()
    assert max(vain, default=0) < 10  # it has learned by then


def iteration_seconds(worker_slots, held):
    """0.05 s, 0.01 s per slot, and 0.1 s per slot to set up a set of slots that is new."""
    setting_up = 0.1 * len(worker_slots) if held != worker_slots else 0.0
    return 0.05 + 0.01 * len(worker_slots) + setting_up


def test_of_two_equal_workers_the_one_that_joins_later_gets_its_share():
    leases, pace, now = Leases(8), Pace(), 0.0
    held: dict[str, tuple[int, ...]] = {}
    leases.join("a")
    for iteration in range(100):
        if iteration == 10:
            leases.join("b")
        leases.seconds = pace.seconds_per_slot
        leases.spread()
        for worker in leases.workers:
            mine = leases.slots_of(worker)
            if mine:
                pace.begin(worker, mine, now)
                pace.end(worker, now + iteration_seconds(mine, held.get(worker)))
            held[worker] = mine
    assert len(leases.slots_of("b")) >= 3  # 7 and 1 take a third longer than 4 and 4


def test_a_worker_whose_failure_is_lost_still_shows_that_it_lives():
    hub = MemoryHub()
    learner, link = hub.learner(), hub.worker("a")
    config = Config(
        run=RunConfig(env="tests.odd_envs:Raises-v0"),
        rollout=RolloutConfig(slots=1, num_envs=1, num_steps=64),
    )
    member = Member("a", link, float("inf"))
    threading.Thread(target=member.live, daemon=True).start()

    def wait_for(kind):
        for _ in range(50):
            event = learner.receive(20.0)
            if isinstance(event, kind) or event is None:
                return event
        return None

    assert wait_for(wire.Hello) is not None
    welcome = replace(WELCOME, config=json.dumps(config.to_dict()))
    learner.send("a", welcome)
    ready = wait_for(wire.Ready)
    spaces = Spaces(obs_size=ready.obs_size, action_kind="discrete", action_sizes=(2,))
    learner.send(
        "a",
        wire.Collect(
            generation=7, iteration=0, round=0, slots=(0,), psi=0.0, beta=1.0, mean_reward=0.0,
            parameters=Networks.build(spaces, config).initial(config),
            obs=np.zeros(1 + 2 * spaces.obs_size), returns=np.zeros(3), sigma_target=np.zeros(3),
        ),
    )  # fmt: skip
    assert wait_for(wire.Failure) is not None  # and nobody has heard it
    assert wait_for(wire.Alive) is not None, "nothing tells the learner to send it a Stop"
