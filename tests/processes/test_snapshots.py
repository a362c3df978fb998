"""An environment goes on elsewhere, in a fresh process, as if it had never moved: to the bit."""

import json
import logging
from itertools import pairwise

import gymnasium
import numpy as np
import pytest

from dppo.config import Config, RolloutConfig, RunConfig, UpdateConfig
from dppo.distributions import distribution_of
from dppo.networks import Networks
from dppo.normalizer import Statistics
from dppo.rollout import Replay
from workers.envs import exactness, make_env, spaces_of
from workers.episodes import Episodes, Row
from workers.failures import EnvironmentFailedError
from workers.slots import Slots

pytestmark = pytest.mark.usefixtures("quiet_libraries")

MUJOCO = [
    ("Hopper-v5", {}), ("Ant-v4", {}), ("Ant-v4", {"use_contact_forces": True}), ("Ant-v5", {}),
    ("HalfCheetah-v4", {}), ("Walker2d-v5", {}), ("Humanoid-v4", {}), ("Reacher-v5", {}),
]  # fmt: skip
LIMIT = 60
"""Steps per episode: short, so that captures fall into first, second and third episodes."""


def episodes(env_id, exact=True, slot=0, **kwargs):
    """The second environment of a slot, alone."""
    run = RunConfig(env=env_id, env_kwargs=json.dumps(kwargs), seed=5)
    rollout = RolloutConfig(slots=8, exact_envs=exact)
    return Episodes(Config(run=run, rollout=rollout), [Row(slot, 1)])


def actions_for(environment, count, seed=0):
    """Random actions, some beyond the bounds: [count, 1, A]."""
    rng = np.random.default_rng(seed)
    space = environment.vec.single_action_space
    if isinstance(space, gymnasium.spaces.Box):
        return rng.standard_normal((count, 1, *space.shape)).astype(np.float32)
    return rng.integers(space.n, size=(count, 1, 1)).astype(np.float32)


def run(environment, actions):
    """Steps as bytes, with the counters after each; a new episode after every end."""
    trace = []
    for action in actions:
        step = environment.step(action)
        if step.terminated[0] or step.truncated[0]:
            environment.begin()
        trace.append((
            step.next_obs.tobytes(), step.reward[0], bool(step.terminated[0]),
            bool(step.truncated[0]), environment.obs.tobytes(), int(environment.episode[0]),
            int(environment.steps[0]), environment.score[0], environment.discounted[0],
        ))  # fmt: skip
    return trace


def as_sent(arrays):
    """Arrays as they arrive elsewhere: copies, whatever happens here later."""
    return {name: np.array(array) for name, array in arrays.items()}


@pytest.mark.parametrize(
    ("env_id", "kwargs"), [*MUJOCO, ("CartPole-v1", {})], ids=lambda v: str(v)
)
def test_a_moved_environment_goes_on_to_the_bit(env_id, kwargs):
    here = episodes(env_id, max_episode_steps=LIMIT, **kwargs)
    here.begin()
    actions = actions_for(here, 260)
    trace = []
    for start, stop in pairwise((0, 35, 97, 150, 210)):
        trace += run(here, actions[start:stop])
        there = episodes(env_id, max_episode_steps=LIMIT, **kwargs)
        there.restore([as_sent(here.capture(0))])
        here_next = episodes(env_id, max_episode_steps=LIMIT, **kwargs)
        here_next.restore([as_sent(there.capture(0))])  # moved on once more
        moved = run(there, actions[stop : stop + 50])
        assert run(here_next, actions[stop : stop + 50]) == moved
        ahead = as_sent(here.capture(0))
        assert run(here, actions[stop : stop + 50]) == moved, f"differs when moved at step {stop}"
        here.restore([ahead])
    ends = [step[2] or step[3] for step in trace]
    assert 1 <= sum(ends) < len(ends), "the test wants several episodes"


def test_the_time_limit_moves_along():
    here = episodes("HalfCheetah-v4", max_episode_steps=LIMIT)
    here.begin()
    run(here, actions_for(here, LIMIT - 5))
    there = episodes("HalfCheetah-v4", max_episode_steps=LIMIT)
    there.restore([here.capture(0)])
    truncated = [step[3] for step in run(there, actions_for(there, 7))]
    assert truncated == [False] * 4 + [True] + [False] * 2


def test_the_generator_of_the_environment_moves_along():
    here, there = episodes("Hopper-v5"), episodes("Hopper-v5")
    here.begin()
    here.vec._generator(0).random(3)
    there.restore([here.capture(0)])
    assert there.vec._generator(0).random() == here.vec._generator(0).random()


@pytest.mark.parametrize("steps", [0, 1])
def test_a_capture_at_the_start_of_an_episode_moves_too(steps):
    for env_id in ("Hopper-v5", "CartPole-v1"):
        here, there = episodes(env_id), episodes(env_id)
        here.begin()
        run(here, actions_for(here, steps))
        there.restore([as_sent(here.capture(0))])
        actions = actions_for(here, 40, seed=1)
        assert run(there, actions) == run(here, actions)


def test_a_capture_is_not_changed_by_what_happens_later():
    here = episodes("Hopper-v5")
    here.begin()
    run(here, actions_for(here, 10))
    captured = here.capture(0)
    before = as_sent(captured)
    run(here, actions_for(here, 30))
    assert all(captured[name].tobytes() == before[name].tobytes() for name in before)


def test_how_an_environment_moves():
    cheetah = make_env(RunConfig(env="HalfCheetah-v4"))
    assert exactness(cheetah, wanted=True) == "captured"
    assert exactness(cheetah, wanted=False) == "off"
    assert exactness(make_env(RunConfig(env="CartPole-v1")), wanted=True) == "replayed"
    foreign = gymnasium.wrappers.ClipReward(cheetah, -1, 1)  # may hide a state of its own
    assert exactness(foreign, wanted=True) == "replayed"


def test_without_exact_environments_a_moved_one_begins_a_new_episode(caplog):
    here, there = episodes("Hopper-v5", exact=False), episodes("Hopper-v5", exact=False)
    here.begin()
    run(here, actions_for(here, 5))
    there.restore([here.capture(0)])
    assert (there.episode[0], there.steps[0], there.score[0]) == (here.episode[0] + 1, 0, 0.0)
    here.begin()
    assert there.obs.tobytes() == here.obs.tobytes()
    assert not caplog.records


def config(env, **rollout):
    return Config(
        run=RunConfig(env=env, env_kwargs=json.dumps({"max_episode_steps": 20}), seed=3),
        rollout=RolloutConfig(slots=2, num_envs=2, num_steps=32, **rollout),
        update=UpdateConfig(critic_replay=True),
    )


def collector(config):
    """Collects with the initial parameters: a slot to its rollout, facts and both as bytes."""
    sizes = spaces_of(make_env(config.run))
    networks = Networks.build(sizes, config)
    parameters = networks.initial(config)
    statistics = Statistics.empty(sizes.obs_size)

    def collect(slots):
        ((rollout, facts),) = slots.collect(
            networks, distribution_of(sizes), parameters, statistics
        )
        vectors = (rollout.obs, rollout.next_obs, rollout.action, rollout.reward, rollout.ended,
                   rollout.terminated, rollout.starts, facts.obs.to_vector(),
                   facts.returns.to_vector(), facts.episodes)  # fmt: skip
        return [vector.tobytes() for vector in vectors]

    return collect


@pytest.mark.parametrize("time_limit", ["bootstrap", "time-feature"])
@pytest.mark.parametrize("env", ["Hopper-v5", "CartPole-v1"])
def test_a_restored_slot_collects_the_same_bits(env, time_limit):
    settings = config(env, time_limit=time_limit)
    collect = collector(settings)
    here = Slots.fresh([1], settings)
    collect(here)
    rng = np.random.default_rng(0)
    here.replays[1] = Replay(
        obs=rng.standard_normal((64, 3)).astype(np.float32),
        v_target=rng.standard_normal(64), sigma_target=rng.standard_normal(64),
    )  # fmt: skip
    there = Slots.restored([1], settings, here.iteration, [here.snapshot(1)])
    assert there.snapshot(1) == here.snapshot(1)
    for name in ("obs", "v_target", "sigma_target"):
        replayed = getattr(there.replays[1], name)
        assert replayed.tobytes() == getattr(here.replays[1], name).tobytes()
    for _ in range(2):
        assert collect(there) == collect(here)
    assert there.iteration == here.iteration == 3
    here.close()
    there.close()


def test_slots_differ_in_everything_and_a_fresh_slot_repeats_itself():
    settings = config("Hopper-v5")
    collect = collector(settings)
    one, again, other = (collect(Slots.fresh([index], settings)) for index in (0, 0, 1))
    assert one == again
    assert one[0] != other[0]
    assert one[2] != other[2]


class Moody(gymnasium.Env):
    """Observations from a counter that no reset clears, or trouble at a given step."""

    observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (2,), np.float64)
    action_space = gymnasium.spaces.Box(-1, 1, (1,), np.float32)
    calls = 0

    def __init__(self, trouble="", at=3):
        self.trouble, self.at, self.steps = trouble, at, 0

    def reset(self, *, seed=None, options=None):  # noqa: ARG002
        self.steps = 0
        if self.trouble == "reset":
            raise RuntimeError("out of cards")
        return np.zeros(2), {}

    def step(self, action):  # noqa: ARG002
        self.steps += 1
        obs = np.array([self.steps, 0.0])
        reward: float | None = 1.0
        if self.trouble == "mood":
            Moody.calls += 1
            obs[1] = Moody.calls
        if self.steps > self.at:
            if self.trouble == "raise":
                raise ValueError("boom")
            obs[1] = np.nan if self.trouble == "obs" else obs[1]
            reward = np.inf if self.trouble == "reward" else reward
            reward = None if self.trouble == "no reward" else reward
        return obs, reward, False, False, {}


@pytest.fixture
def _moody():
    gymnasium.register("Moody-v0", lambda **kwargs: Moody(**kwargs), disable_env_checker=True)
    yield
    del gymnasium.registry["Moody-v0"]


@pytest.mark.usefixtures("_moody")
@pytest.mark.parametrize("trouble", ["mood", ""])
def test_only_a_moody_environment_is_reported_as_no_longer_exact(caplog, trouble):
    here, there = (episodes("Moody-v0", trouble=trouble, slot=4) for _ in range(2))
    here.begin()
    run(here, actions_for(here, 3))
    with caplog.at_level(logging.WARNING, "worker"):
        there.restore([as_sent(here.capture(0))])
    assert there.obs.tobytes() == here.obs.tobytes()  # what the policy saw is kept in any case
    sentence = "slot 4, environment 1: replaying 3 actions ended in another observation"
    assert (sentence in caplog.text) == (trouble == "mood")
    assert ("no longer exact" in caplog.text) == (trouble == "mood")


@pytest.mark.usefixtures("_moody")
@pytest.mark.parametrize(
    ("trouble", "sentence"),
    [
        ("obs", r"returned a.* observation \[4.0, nan\] that is not finite"),
        ("reward", "returned a reward that is not finite .reward inf."),
        ("no reward", "raised TypeError: float"),
        ("raise", "raised ValueError: boom"),
    ],
)
def test_a_failed_step_names_slot_environment_and_step(trouble, sentence):
    environment = episodes("Moody-v0", trouble=trouble, slot=4)
    environment.begin()
    where = r"slot 4, environment 1 \(Moody-v0\) "
    with pytest.raises(
        EnvironmentFailedError, match=where + sentence + ".* at step 3 of episode 0"
    ):
        run(environment, actions_for(environment, 9))


@pytest.mark.usefixtures("_moody")
def test_a_failed_reset_names_slot_environment_and_seed():
    environment = episodes("Moody-v0", trouble="reset")
    sentence = (
        r"slot 0, environment 1 .*raised RuntimeError in reset: out of cards .*reset seed \d"
    )
    with pytest.raises(EnvironmentFailedError, match=sentence):
        environment.begin()


@pytest.mark.usefixtures("_moody")
def test_a_failure_while_replaying_is_named_as_well():
    here = episodes("Moody-v0")
    here.begin()
    run(here, actions_for(here, 5))
    there = episodes("Moody-v0", trouble="raise")
    with pytest.raises(EnvironmentFailedError, match=r"environment 1 .*raised ValueError: boom"):
        there.restore([here.capture(0)])
