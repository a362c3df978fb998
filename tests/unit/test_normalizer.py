"""What the networks see and what rewards are worth, from hand-counted moments."""

import math

import numpy as np
import pytest

from dppo.config import Config, ReturnsConfig, RolloutConfig
from dppo.moments import Moments
from dppo.normalizer import Statistics

FLOAT32 = float(np.spacing(np.float32(1)))


def seen(obs=(), returns=(), sigma_target=()):
    parts = [np.array(obs, np.float64).reshape(-1, 2), np.array(returns), np.array(sigma_target)]
    return Statistics(*(Moments.of(part) for part in parts))


TWO = seen(obs=[[0.0, 10.0], [2.0, 10.0]])
"""Means 1 and 10, standard deviations 1 and 0."""


@pytest.mark.parametrize("form", ["std", "paper", "off"])
def test_observations_pass_unchanged_before_any_were_seen(form):
    normalize = Statistics.empty(2).obs_normalizer(RolloutConfig(normalize_obs=form))
    assert normalize(np.array([3.0, -9.5])).tolist() == [3.0, -9.5]


def test_off_leaves_observations_as_they_are():
    normalize = TWO.obs_normalizer(RolloutConfig(normalize_obs="off"))
    assert normalize(np.array([150.0, -37.0])).tolist() == [150.0, -37.0]  # beyond --clip-obs
    assert normalize(np.array([3.0, -9.5])).tolist() == [3.0, -9.5]


def test_std_form():
    normalize = TWO.obs_normalizer(RolloutConfig(normalize_obs="std"))
    # (3 - 1) / √(1² + 1e-8), and (10.00005 - 10) / √(0² + 1e-8)
    expected = [2 / math.sqrt(1 + 1e-8), 0.00005 / 1e-4]
    np.testing.assert_allclose(normalize(np.array([3.0, 10.00005])), expected, rtol=FLOAT32)


def test_paper_form():
    normalize = TWO.obs_normalizer(RolloutConfig(normalize_obs="paper"))
    # (o - mean) / (3 (std + 0.1)): 3.3 / 3.3 and 1.5 / 0.3
    np.testing.assert_allclose(normalize(np.array([4.3, 11.5])), [1.0, 5.0], rtol=FLOAT32)


def test_normalised_observations_are_clipped_on_both_sides():
    normalize = TWO.obs_normalizer(RolloutConfig(clip_obs=5.0))
    assert normalize(np.array([[1e9, 9.0], [-1e9, 11.0]])).tolist() == [[5.0, -5.0], [-5.0, 5.0]]


def test_an_infinite_bound_clips_nothing():
    normalize = TWO.obs_normalizer(RolloutConfig(clip_obs=math.inf))
    expected = [1e6 / math.sqrt(1 + 1e-8)]
    np.testing.assert_allclose(normalize(np.array([1e6 + 1, 10.0]))[:1], expected, rtol=FLOAT32)


def test_normalising_leaves_the_raw_observations_alone():
    raw = np.array([3.0, 10.0])
    normalised = TWO.obs_normalizer(RolloutConfig())(raw)
    assert raw.tolist() == [3.0, 10.0]
    assert normalised.dtype == np.float32


def scaled_by(reward_scale, gamma=0.99):
    return Config(
        rollout=RolloutConfig(reward_scale=reward_scale),
        returns=ReturnsConfig(gamma=gamma, gamma_start=-1),
    )


def test_rewards_are_divided_by_the_std_of_the_discounted_return():
    assert seen(returns=[0.0, 4.0]).reward_scale(scaled_by("running-std")) == 0.5


def test_rewards_keep_their_scale_before_any_was_seen():
    assert Statistics.empty(2).reward_scale(scaled_by("running-std")) == 1.0


def test_constant_returns_do_not_blow_rewards_up():
    assert seen(returns=[3.0, 3.0]).reward_scale(scaled_by("running-std")) == 1 / 1e-4


@pytest.mark.parametrize(
    ("gamma", "scale"), [(0.75, 0.25), (0.998, 1 - 0.998), (0.999, 1), (1, 1)]
)
def test_rewards_times_one_minus_gamma(gamma, scale):
    config = scaled_by("one-minus-gamma", gamma)
    assert seen(returns=[0.0, 4.0]).reward_scale(config) == scale


def test_raw_rewards():
    assert seen(returns=[0.0, 4.0]).reward_scale(scaled_by("off")) == 1.0


def test_sigma_has_the_unit_of_a_squared_scaled_reward():
    statistics = seen(returns=[0.0, 4.0], sigma_target=[1.0, 7.0])
    # std 3 of the raw targets, times (1/2)² of the reward scale
    assert statistics.sigma_scale(scaled_by("running-std")) == 0.75
    assert statistics.sigma_scale(scaled_by("off")) == 3.0


def test_sigma_scale_before_any_target_is_the_variance_of_the_returns():
    statistics = seen(returns=[0.0, 4.0])
    assert statistics.sigma_scale(scaled_by("off")) == 4.0
    assert statistics.sigma_scale(scaled_by("running-std")) == 1.0
    assert Statistics.empty(1).sigma_scale(scaled_by("running-std")) == 1.0


def test_constant_sigma_targets_keep_a_floor():
    assert seen(sigma_target=[5.0, 5.0]).sigma_scale(scaled_by("off")) == 1e-12


def test_merging_statistics_merges_all_three():
    both = TWO.merge(seen(obs=[[4.0, 10.0]], returns=[1.0], sigma_target=[2.0, 4.0]))
    assert both.obs.count == 3
    assert both.obs.mean.tolist() == [2.0, 10.0]
    assert both.returns.mean == [1.0]
    assert (both.sigma_target.count, both.sigma_target.mean) == (2, [3.0])
