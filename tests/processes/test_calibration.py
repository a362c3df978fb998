"""σ against the spread of returns, where both are known: coins, and a V and σ that are exact."""

import dataclasses
import json
import re

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces

from dppo.config import Config
from dppo.errors import UsageError
from dppo.moments import Moments
from dppo.networks import Network, Networks
from dppo.store.checkpoint import Checkpoint
from dppo.store.contents import chosen
from tests.support import SMALL
from workers.calibration import Calibrator
from workers.envs import make_env, spaces_of
from workers.evaluate import evaluate, policy_of

GAMMA, STEPS = 0.9, 4
MEAN, COIN = 2.0, np.array([3.0, 1.0, 0.5, 2.0])
"""Reward of step t: 2 plus or minus COIN[t]."""


class Coins(gymnasium.Env):
    """Four steps, each with a coin of its own; the observation is the step, one-hot."""

    observation_space = spaces.Box(0, 1, (STEPS,), np.float64)
    action_space = spaces.Discrete(2)

    def __init__(self, endless=False, falls=False):
        self.endless, self.falls, self.at = endless, falls, 0

    def reset(self, *, seed=None, options=None):  # noqa: ARG002
        super().reset(seed=seed)
        self.at = 0
        return self._obs(), {}

    def step(self, action):  # noqa: ARG002
        reward = MEAN + COIN[self.at] * (1 if self.np_random.random() < 0.5 else -1)
        self.at += 1
        over = self.at == STEPS
        falls = over and (self.np_random.random() < 0.5 if self.falls else not self.endless)
        return self._obs(), reward, falls, over and not falls, {}

    def _obs(self):
        obs = np.zeros(STEPS)
        if self.at < STEPS:
            obs[self.at] = 1
        return obs


@pytest.fixture(autouse=True)
def _coins():
    gymnasium.register("Coins-v0", lambda **kwargs: Coins(**kwargs))
    yield
    del gymnasium.registry["Coins-v0"]


def discounted(values, discount):
    """Σ_l d^l x_{t+l} for each t."""
    sums = np.zeros(len(values) + 1)
    for t in reversed(range(len(values))):
        sums[t] = values[t] + discount * sums[t + 1]
    return sums[:-1]


def exact_sigma(lambda_ret):
    return discounted(np.square(COIN), (GAMMA * lambda_ret) ** 2)


def checkpoint(lambda_ret=1.0, sigma_factor=1.0, v_shift=0.0, **env):
    """Networks that give the exact V and σ: hidden unit t is tanh(20) = 1 at step t, else 0."""
    config = Config.from_dict({
        "run": {"env": "Coins-v0", "env_kwargs": json.dumps(env)},
        "rollout": {"normalize_obs": "off"},
        "returns": {"gamma": GAMMA, "gae_lambda": 0.7, "lambda_ret": lambda_ret},
        "safety": {"sigma_head": "linear"},
        "network": {"hidden_sizes": [STEPS]},
    })  # fmt: skip
    sizes = spaces_of(make_env(config.run))
    networks = Networks.build(sizes, config)
    parameters = np.zeros(networks.size, np.float32)
    reward_std, sigma_std = 4.0, 0.5
    exact_v = discounted(np.full(STEPS, MEAN), GAMMA)
    outputs_of: dict[Network, np.ndarray] = {
        "value": (exact_v + v_shift) / reward_std,
        "variance": sigma_factor * exact_sigma(lambda_ret) / sigma_std,
    }
    for name, outputs in outputs_of.items():
        (w1, _), (w2, _) = networks.value.layers(parameters[networks.parts[name]])
        w1[:], w2[:, 0] = 20 * np.eye(STEPS), outputs
    arrays: dict[str, np.ndarray] = {
        "parameters": parameters,
        "statistics/obs": Moments.empty(STEPS).to_vector(),
        "statistics/returns": np.array([10.0, 1.0, 10 * reward_std**2]),
        "statistics/sigma_target": np.array([10.0, 7.0, 10 * sigma_std**2]),
        "episodes": np.array([[MEAN * STEPS, STEPS]]),
    }
    facts = {
        "config": config.to_dict(),
        "spaces": dataclasses.asdict(sizes),
        "state": {"iteration": 1},
    }
    return Checkpoint(arrays, facts)


def calibrated(made, episodes=400, places=2):
    policy = policy_of(made)
    calibrator = Calibrator(policy)
    result = evaluate(
        policy,
        episodes=episodes,
        deterministic=False,
        seed=0,
        places=places,
        watch=calibrator.note,
    )
    return result, calibrator.result(0)


@pytest.mark.parametrize("lambda_ret", [1.0, 0.5])
def test_an_exact_sigma_is_calibrated(lambda_ret):
    """Of 400 episodes a standard deviation is known to about 1 / sqrt(800) = 3.5 %."""
    _, found = calibrated(checkpoint(lambda_ret))
    truth = np.sqrt(exact_sigma(lambda_ret)[0])
    assert (found.gamma, found.lambda_ret) == (GAMMA, lambda_ret)
    assert len(found.starts) == 2
    for start in found.starts:
        assert start.predicted_std == pytest.approx(truth, rel=1e-5)
        assert start.empirical_std == pytest.approx(truth, rel=0.12)
        # δ² of a coin is no random number, so the sum of squares is exact
        assert start.squares_std == pytest.approx(truth, rel=1e-5)
        assert abs(start.v_error) < 4 * truth / 20
        low, high = start.ratio_interval
        assert low < start.ratio < high
        assert start.ratio == pytest.approx(start.predicted_std / start.empirical_std, rel=1e-12)
    low, high = found.ratio_interval
    assert 0.9 < low < 1 < high < 1.1
    assert found.along_ratio == pytest.approx(1, abs=0.05)
    assert found.along_squares_ratio == pytest.approx(1, rel=1e-5)
    tenths = {round(part.predicted_std, 3) for part in found.bins}
    assert tenths >= {round(float(np.sqrt(exact_sigma(lambda_ret).min())), 3)}


def test_with_the_full_return_the_empirical_deviation_is_that_of_the_discounted_return():
    result, found = calibrated(checkpoint(lambda_ret=1.0), places=1)
    fixed = [episode.discounted for episode in result.episodes if episode.plan.start == "fixed"]
    assert found.starts[0].empirical_std == pytest.approx(np.std(fixed, ddof=1), rel=1e-6)
    assert found.starts[0].discounted_std == pytest.approx(np.std(fixed, ddof=1), rel=1e-12)


def test_the_outlook_of_a_state_is_v_and_the_root_of_sigma_in_raw_reward():
    found = policy_of(checkpoint()).outlook(np.eye(STEPS), np.arange(STEPS))
    assert found.value == pytest.approx(discounted(np.full(STEPS, MEAN), GAMMA), rel=1e-5)
    assert found.std == pytest.approx(np.sqrt(exact_sigma(1.0)), rel=1e-5)
    negative = policy_of(checkpoint(sigma_factor=-1.0)).outlook(np.eye(STEPS), np.arange(STEPS))
    assert negative.std is not None
    assert not negative.std.any()


@pytest.mark.slow
def test_the_outlook_of_a_trained_run_is_what_the_calibration_takes_as_predicted(runs):
    """With σ's default head, and a run without σ."""
    run = runs("InvertedPendulum-v5", "--seed", "4")
    _, made = chosen(str(run), "newest")
    policy, seen = policy_of(made), []
    calibrator = Calibrator(policy)

    def note(episode, trajectory):
        calibrator.note(episode, trajectory)
        seen.append(trajectory.obs[0])

    evaluate(policy, episodes=2, deterministic=False, seed=0, places=1, watch=note)
    (start,) = calibrator.result(0).starts
    found = policy.outlook(np.array(seen[:1]), np.zeros(1, int))
    assert found.std == pytest.approx(start.predicted_std, rel=1e-6)
    bare = runs("InvertedPendulum-v5", "--psi", "0", "--no-variance-critic")
    assert (
        policy_of(chosen(str(bare), "newest")[1]).outlook(seen[0][None], np.zeros(1, int)).std
        is None
    )


@pytest.mark.slow
def test_a_sigma_that_is_four_times_too_large_shows_as_a_ratio_of_two():
    _, right = calibrated(checkpoint())
    _, wrong = calibrated(checkpoint(sigma_factor=4.0))
    assert wrong.ratio == pytest.approx(2 * right.ratio, rel=1e-6)
    assert wrong.along_ratio == pytest.approx(2 * right.along_ratio, rel=1e-6)
    assert wrong.along_squares_ratio == pytest.approx(2, rel=1e-5)


@pytest.mark.slow
def test_an_error_of_v_shows_along_the_trajectories_and_in_its_own_column():
    """Full return: a V that is 5 too high everywhere leaves the spread from s_0 as it is."""
    _, right = calibrated(checkpoint())
    _, wrong = calibrated(checkpoint(v_shift=5.0))
    assert wrong.ratio == pytest.approx(right.ratio, rel=1e-5)
    assert wrong.along_ratio < 0.6 * right.along_ratio
    shift = wrong.starts[0].v_error - right.starts[0].v_error
    assert shift == pytest.approx(-5.0, rel=1e-5)


def test_steps_near_a_time_limit_are_left_out_along_the_trajectories():
    """γ̄ = 0.81: what lies 22 steps ahead still counts for a hundredth; episodes have 4 steps."""
    _, found = calibrated(checkpoint(endless=True), episodes=20)
    assert (found.along_ratio, found.along_ratio_interval, found.bins) == (None, None, ())
    assert found.along_squares_ratio is None
    assert found.ratio > 0


def test_steps_near_a_time_limit_are_left_out_of_episodes_that_fall_there_too():
    """γ̄ = 0.2: steps within 3 of the limit, 4, go; those of falls alone would overstate spread."""
    _, found = calibrated(checkpoint(lambda_ret=0.5, falls=True), episodes=20)
    assert sum(one.steps for one in found.bins) == 2 * 20  # the first step of each


@pytest.mark.parametrize("episodes", [2, 3])
def test_of_very_few_episodes_most_resamples_do_not_spread_and_bounds_are_left_out(episodes):
    """Of two, half of the resamples are twice the same one; of three, one in nine thrice."""
    _, found = calibrated(checkpoint(), episodes=episodes)
    assert found.ratio > 0
    assert [found.ratio_interval] + [one.ratio_interval for one in found.starts] == [None] * 3
    assert all(np.isfinite(one.empirical_std_interval).all() for one in found.starts)
    assert np.isfinite(found.along_ratio_interval).all()
    json.dumps(found.to_dict(), allow_nan=False)


def test_where_nothing_spreads_there_is_no_ratio(monkeypatch):
    monkeypatch.setattr(f"{__name__}.COIN", np.zeros(STEPS))
    _, found = calibrated(checkpoint(), episodes=4)
    assert [found.ratio] + [one.ratio for one in found.starts] == [None] * 3
    assert found.ratio_interval is None
    assert [one.empirical_std for one in found.starts] == [0, 0]
    json.dumps(found.to_dict(), allow_nan=False)


def test_runs_without_a_sigma_that_is_a_variance_are_refused():
    made = checkpoint()
    made.facts["config"]["returns"]["gamma_bar"] = "authors-2019"
    with pytest.raises(UsageError, match=r"gamma_bar authors-2019.*not the variance of a return"):
        Calibrator(policy_of(made))
    made = checkpoint()
    made.facts["config"]["safety"]["variance_critic"] = False
    with pytest.raises(UsageError, match=r"no variance critic \(--no-variance-critic\)"):
        Calibrator(policy_of(made))


@pytest.mark.slow
def test_dppo_eval_calibration_prints_the_same_twice(harness):
    run_dir = harness.folder / "run"
    args = ("--env", "HopperActionNoise-v5", *SMALL, "--total-timesteps", "1536")
    harness.train(*args, "--local-workers", "1", run_dir=run_dir)
    words = ("dppo", "eval", str(run_dir), "--calibration", "--episodes", "6", "--starts", "2")
    for more in ((), ("--json",)):
        one, other = (harness.start(*words, *more, "--rows", rows) for rows in ("4", "16"))
        assert (one.wait(), other.wait()) == (0, 0), one.text
        assert one.text == other.text
    found = json.loads(one.text)
    assert len(found["episodes"]) == 18
    assert [start["episodes"] for start in found["calibration"]["starts"]] == [6, 6]
    low, high = found["calibration"]["ratio_interval"]
    assert 0 < low < found["calibration"]["ratio"] < high
    few = harness.start("dppo", "eval", str(run_dir), "--calibration", "--episodes", "2")
    assert few.wait() == 0, few.text
    (line,) = (line for line in few.text.splitlines() if line.startswith("  all starts: ratio "))
    assert re.fullmatch(r"  all starts: ratio \d+\.\d{3} -", line)
    refused = harness.start(*words, "--deterministic")
    assert refused.wait() == 2
    assert "off with --calibration: sigma is of the policy that samples" in " ".join(
        refused.text.replace("│", " ").split()
    )
