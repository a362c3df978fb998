"""The objective, its hinge, and how the two advantages meet: by hand."""

from math import exp, log
from typing import Any

import numpy as np
import pytest

from dppo.config import KlConfig, SafetyConfig
from dppo.losses import (
    AdvantageStatistics,
    advantage_moments,
    combine,
    kl_weight,
    policy_objective,
    softplus,
    softplus_derivative,
)

KL = KlConfig(kl_target=0.25, hinge_coef=8.0)
GAIN = np.array([[2, -1]], np.float32)  # of one set of samples, mean 1/2


def _one(kl):
    return np.array([kl])


def test_sets_of_samples_do_not_mix():
    gains, kls = np.array([[2, -1], [0, 4]], np.float32), np.array([0.5, 0.75])
    assert policy_objective(gains, kls, 3.0, KL).tolist() == [-1.0, 2 - 2.25 - 0.5]
    assert kl_weight(kls, 3.0, KL).tolist() == [3.0, 7.0]


def _statistics(slots, psi):
    """Moments over the samples of all slots, merged in slot order as the chief does."""
    first, *others = [advantage_moments(a_v, a_sigma, psi) for a_v, a_sigma in slots]
    for other in others:
        first = first.merge(other)
    return AdvantageStatistics(first)


def test_the_hinge_is_still_below_twice_the_target():
    assert kl_weight(_one(0.5), 3.0, KL) == 3.0
    # mean gain 1/2, minus 3 * 0.5
    assert policy_objective(GAIN, _one(0.5), 3.0, KL) == 0.5 - 1.5


def test_the_hinge_adds_its_slope_above_twice_the_target():
    # beta + 2 xi (KL - 2 target) = 3 + 16 * 0.25
    assert kl_weight(_one(0.75), 3.0, KL) == 7.0
    # 1/2 - 3 * 0.75 - 8 * 0.25²
    assert policy_objective(GAIN, _one(0.75), 3.0, KL) == 0.5 - 2.25 - 0.5


def test_kl_weight_is_minus_the_slope_of_the_objective():
    for kl in (0.1, 0.7):
        rise = policy_objective(GAIN, _one(kl + 0.01), 3.0, KL) - policy_objective(
            GAIN, _one(kl - 0.01), 3.0, KL
        )  # J is quadratic in KL on both sides: the central difference is exact
        assert kl_weight(_one(kl), 3.0, KL) == pytest.approx(-rise / 0.02, rel=1e-12)


# Two slots: A_V = 0, 0 and 2, 2 has mean 1 and std 1; A_sigma = 0, 8 and 0, 8 mean 4 and std 4.
SLOTS = [
    (np.array([0.0, 0.0]), np.array([0.0, 8.0])),
    (np.array([2.0, 2.0]), np.array([0.0, 8.0])),
]


def test_separate_standardises_each_over_all_slots_and_not_the_sum():
    statistics = _statistics(SLOTS, 0.5)
    combined = [combine(v, sigma, 0.5, statistics, SafetyConfig(psi=0.5)) for v, sigma in SLOTS]
    # (-1, -1, 1, 1) - 0.5 (-1, 1, -1, 1)
    np.testing.assert_array_equal(np.concatenate(combined), [-0.5, -1.5, 1.5, 0.5])
    assert combined[0].dtype == np.float32


def test_joint_standardises_the_sum():
    statistics = _statistics(SLOTS, 0.5)
    config = SafetyConfig(psi=0.5, adv_norm="joint")
    combined = [combine(v, sigma, 0.5, statistics, config) for v, sigma in SLOTS]
    # A_V - A_sigma / 2 = 0, -4, 2, -2: mean -1, deviations 1, -3, 3, -1, variance 5
    expected = np.array([1, -3, 3, -1]) / np.sqrt(5)
    np.testing.assert_allclose(np.concatenate(combined), expected, rtol=1e-7)


def test_none_leaves_reward_units():
    statistics = _statistics(SLOTS, 0.5)
    config = SafetyConfig(psi=0.5, adv_norm="none")
    combined = [combine(v, sigma, 0.5, statistics, config) for v, sigma in SLOTS]
    np.testing.assert_array_equal(np.concatenate(combined), [0, -4, 2, -2])


def test_the_std_of_a_sigma_is_at_least_a_thousandth_of_a_vs_variance():
    # A_V = -2, 2: std 2, floor 1e-3 * 2²; A_sigma = -0.001, 0.001: std 0.001, floored to 0.004
    a_v, a_sigma = np.array([-2.0, 2.0]), np.array([-0.001, 0.001])
    statistics = _statistics([(a_v, a_sigma)], 1.0)
    assert statistics.stds[:2] == (2.0, 0.004)
    combined = combine(a_v, a_sigma, 1.0, statistics, SafetyConfig(psi=1.0))
    np.testing.assert_allclose(combined, [-1 + 0.25, 1 - 0.25], rtol=1e-7)


@pytest.mark.parametrize("spread", [0.001, 1.0])
@pytest.mark.parametrize("scale", [2.0**-7, 2.0**-17])
def test_the_floor_has_no_unit_of_its_own(spread, scale):
    a_v, a_sigma = np.array([-2.0, 2.0, 1.0]), spread * np.array([1.0, -1.0, 0.0])
    config = SafetyConfig(psi=0.3)  # reward times c: A_V times c, A_sigma c²
    one = combine(a_v, a_sigma, 0.3, _statistics([(a_v, a_sigma)], 0.3), config)
    scaled = (scale * a_v, scale**2 * a_sigma)
    other = combine(*scaled, 0.3, _statistics([scaled], 0.3), config)
    assert one.tobytes() == other.tobytes()


@pytest.mark.parametrize("adv_norm", ["separate", "joint"])
def test_without_psi_the_advantage_is_the_standardised_a_v_bit_for_bit(adv_norm):
    rng = np.random.default_rng(0)
    a_v, a_sigma = rng.normal(size=100), rng.normal(size=100) ** 2
    config = SafetyConfig(adv_norm=adv_norm)
    found = combine(a_v, a_sigma, 0.0, _statistics([(a_v, a_sigma)], 0.0), config)
    without = combine(a_v, 0 * a_v, 0.0, _statistics([(a_v, 0 * a_v)], 0.0), config)
    moments = _statistics([(a_v, a_sigma)], 0.0).moments
    plain = ((a_v - moments.mean[0]) / np.sqrt(moments.m2[0] / 100)).astype(np.float32)
    assert found.tobytes() == without.tobytes() == plain.tobytes()


def test_softplus_and_its_slope_by_hand():
    x: Any = np.array([0.0, log(3), -log(3)])
    np.testing.assert_allclose(softplus(x), [log(2), log(4), log(4 / 3)], rtol=1e-15)
    np.testing.assert_allclose(softplus_derivative(x), [0.5, 0.75, 0.25], rtol=1e-15)


def test_softplus_does_not_overflow_and_keeps_small_values():
    x = np.array([1000, -1000, -20], np.float32)
    np.testing.assert_allclose(softplus(x), [1000, 0, exp(-20)], rtol=1e-6)
    np.testing.assert_allclose(softplus_derivative(x), [1, 0, exp(-20)], rtol=1e-6)
