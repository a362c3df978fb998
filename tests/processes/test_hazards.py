"""Tasks with a hazard: batched against the plain wrapper to the bit, moved exactly, fair."""

import json
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from dppo.config import RunConfig
from dppo.errors import UsageError
from tests.bits import assert_same, compare, random_actions, trained_actions
from tests.support import SMALL
from workers import hazards
from workers.envs import exactness, make_env, make_vec
from workers.hazardous_vec import HazardousVec

pytestmark = pytest.mark.usefixtures("quiet_libraries")

IDS = list(hazards.ids())
BOTH: dict[str, Any] = {"noise_std": 0.2, "risk": 3.0, "threshold": 0.1}
"""Both hazards at once, the second one often."""


@pytest.mark.parametrize("env_id", IDS)
def test_a_batched_hazard_has_the_bits_of_the_wrapper(env_id):
    assert compare(env_id, 60, random_actions(env_id), max_episode_steps=25) > 0


@pytest.mark.parametrize("mode", AutoresetMode)
@pytest.mark.parametrize("env_id", ["HopperActionNoise-v5", "AntRiskySpeed-v4"])
def test_both_hazards_in_every_mode_of_beginning_anew(env_id, mode):
    limits = {"mode": mode, "max_episode_steps": 40}
    assert compare(env_id, 120, random_actions(env_id), **limits, **BOTH) > 3


@pytest.mark.slow
@pytest.mark.parametrize("name", ["Ant", "HalfCheetah", "Hopper", "Walker2d"])
def test_whole_episodes_of_a_trained_policy_have_the_bits_of_the_wrapper(name):
    act = trained_actions(f"{name}-v4")
    ends = compare(f"{name}ActionNoise-v4", 1250, act, num_envs=4, **BOTH)
    assert ends > 0


def test_a_trained_policy_meets_the_hazards_and_the_gamble_is_in_the_infos():
    vec = make_vec("HopperRiskySpeed-v4", 4, threshold=1.0)
    act = trained_actions("Hopper-v4")
    obs, _ = vec.reset(seed=[1, 2, 3, 4])
    gambles, speeds = [], []
    for step in range(200):
        obs, _, _, _, info = vec.step(act(step, obs))
        gambles.append(info["gamble"])
        speeds.append(info["x_velocity"])
    gamble, speed = np.array(gambles), np.array(speeds)
    assert set(np.unique(gamble)) == {-10.0, 0.0, 10.0}
    assert ((gamble != 0) == (speed > 1.0)).all()


@pytest.mark.parametrize("env_id", ["HopperActionNoise-v5", "HalfCheetahRiskyAngle-v4"])
def test_a_row_goes_on_elsewhere_with_its_noise(env_id):
    here, there = (make_vec(env_id, 2, max_episode_steps=30, **BOTH) for _ in range(2))
    act = random_actions(env_id)
    obs, _ = here.reset(seed=[1, 2])
    there.reset(seed=[8, 9])
    for step in range(70):
        if step % 10 == 0:
            there.restore(here.snapshot([1, 0]), [0, 1])  # rows change places
        action = act(step, obs)
        expected, found = here.step(action), there.step(action[::-1])
        assert_same(tuple(x[::-1] for x in expected[:4]), found[:4], f"step {step}")
        obs = expected[0]
        if (expected[2] | expected[3]).any():
            there.restore(here.snapshot([1, 0]), [0, 1])


def steps_alike(env_id, plain_id, **kwargs):
    """Rewards of the same zero actions with a hazard and without."""
    rewards = []
    for name, options in ((env_id, kwargs), (plain_id, {})):
        env = make_env(RunConfig(env=name, env_kwargs=json.dumps(options)))
        env.reset(seed=4)
        rewards.append([float(env.step(np.zeros(6, np.float32))[1]) for _ in range(400)])
    return np.array(rewards)


def test_a_gamble_leaves_the_physics_alone_and_has_mean_zero():
    """400 fair coins of 10: the mean's standard error is 10 / 20 = 0.5."""
    risky, plain = steps_alike("HalfCheetahRiskySpeed-v4", "HalfCheetah-v4", threshold=-100.0)
    gamble = risky - plain
    np.testing.assert_allclose(np.abs(gamble), 10.0, rtol=1e-12)
    assert abs(gamble.mean()) < 4 * 0.5
    assert abs(np.corrcoef(gamble[1:], gamble[:-1])[0, 1]) < 4 / 20


def test_action_noise_has_the_std_that_is_asked_for_and_stays_within_bounds():
    """Ten thousand draws per joint: the std's standard error is 0.7 %."""
    env = hazards.make("Hopper-v4", noise_std=0.1)
    space: Any = env.action_space
    draws = np.random.default_rng(0).standard_normal((10_000, 3))
    noisy = env.hazard.disturbed(np.zeros((10_000, 3), np.float32), draws, space)
    np.testing.assert_allclose(noisy.std(axis=0), 0.1 * (space.high - space.low) / 2, rtol=0.03)
    at_border = env.hazard.disturbed(np.ones((10_000, 3), np.float32), draws, space)
    assert at_border.max() == space.high[0]
    assert (at_border < 1).mean() == pytest.approx(0.5, abs=0.02)
    assert noisy.dtype == space.dtype


def test_without_noise_and_risk_nothing_is_added():
    rewards = steps_alike("HalfCheetahActionNoise-v5", "HalfCheetah-v5", noise_std=0.0)
    assert rewards[0].tolist() == rewards[1].tolist()


def test_ids_work_with_gymnasium_and_are_captured_as_whole():
    env = gymnasium.make("workers.hazards:Walker2dRiskyAngle-v5", threshold=0.5)
    assert env.spec is not None
    assert env.spec.max_episode_steps == 1000
    assert hazards.hazard_of(env) == hazards.Hazard(risk=10.0, threshold=0.5, over="angle")
    assert exactness(env, wanted=True) == "captured"
    assert isinstance(make_vec("AntActionNoise-v4", 2), HazardousVec)


@pytest.mark.parametrize(
    ("env_id", "kwargs", "sentence"),
    [
        ("HopperActionNoise-v4", {"noise_std": -1}, "noise_std is -1, expected a finite number"),
        ("AntRiskySpeed-v4", {"over": "angle"}, "Ant's torso has no one angle"),
        ("AntRiskySpeed-v4", {"over": "height"}, "over is 'height', expected 'speed' or 'angle'"),
        ("HopperRiskySpeed-v5", {"speed": 3}, "TypeError"),
    ],
)
def test_wrong_parameters_are_named(env_id, kwargs, sentence):
    with pytest.raises(UsageError, match=sentence):
        make_env(RunConfig(env=env_id, env_kwargs=json.dumps(kwargs)))


@pytest.mark.slow
def test_a_run_on_a_hazard_has_the_same_bits_with_one_worker_and_with_two(harness):
    hashes = []
    for workers in ("1", "2"):
        args = ("--env", "HopperRiskySpeed-v4", "--env-kwargs", json.dumps(BOTH), *SMALL)
        found = harness.train(
            *args, "--total-timesteps", "1536", "--local-workers", workers,
            run_dir=harness.folder / workers,
        )  # fmt: skip
        hashes.append(found["parameters_sha256"])
        assert found["exact"]
    assert hashes[0] == hashes[1]
