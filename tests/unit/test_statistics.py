"""Tails and bootstrap intervals, against numbers worked out here."""

import math

import numpy as np
import pytest

from dppo.statistics import cvar, intervals, tail_mean, wilson_interval


def mean(values):
    return values.mean(axis=-1)


def test_cvar_is_the_mean_of_the_worst_tenth_and_of_one_at_least():
    assert cvar(np.array([5.0, 1.0, 3.0])) == 1.0
    assert cvar(np.arange(20.0)[::-1]) == 0.5
    assert cvar(np.arange(20.0), fraction=0.25) == 2.0


def test_the_tail_of_several_samples_is_that_of_each():
    rows = np.random.default_rng(0).normal(size=(3, 40))
    assert tail_mean(rows).tolist() == [cvar(row) for row in rows]


def test_the_interval_of_a_mean_is_about_two_standard_errors_wide():
    values = np.random.default_rng(1).normal(10, 3, size=400)
    low, high = intervals(values, {"mean": mean}, np.random.default_rng(0))["mean"]
    error = values.std() / math.sqrt(400)
    assert low == pytest.approx(values.mean() - 1.96 * error, abs=0.15 * error)
    assert high == pytest.approx(values.mean() + 1.96 * error, abs=0.15 * error)


def test_95_of_100_intervals_hold_the_truth():
    """Binomial: 100 samples of 60, 0.95 each: 88 and more in 99.6 of 100 cases."""
    rng = np.random.default_rng(2)
    samples = [rng.exponential(1.0, size=60) for _ in range(100)]
    bounds = [intervals(values, {"mean": mean}, rng)["mean"] for values in samples]
    assert sum(low <= 1 <= high for low, high in bounds) >= 88


def test_equal_generators_give_equal_intervals_and_one_value_gives_a_point():
    values = np.arange(10.0)
    one, other = (
        intervals(values, {"mean": mean, "tail": tail_mean}, np.random.default_rng(3))
        for _ in range(2)
    )
    assert one == other
    alone = intervals(np.array([4.0]), {"mean": mean}, np.random.default_rng(3))
    assert alone["mean"] == (4.0, 4.0)


def test_rows_of_several_numbers_are_drawn_together():
    """A ratio of two columns that move together is known better than either."""
    base = np.random.default_rng(4).exponential(1.0, size=100)
    pairs = np.stack([2 * base, base], axis=1)

    def ratio(sample):
        return sample[..., 0, :].mean(axis=-1) / sample[..., 1, :].mean(axis=-1)

    low, high = intervals(pairs, {"ratio": ratio}, np.random.default_rng(0))["ratio"]
    assert (low, high) == pytest.approx((2.0, 2.0), rel=1e-12)


@pytest.mark.parametrize(
    ("count", "trials", "expected"),
    [  # Newcombe (1998), Statistics in Medicine 17: 857-872, Table I, method 3
        (81, 263, (0.2553, 0.3662)),
        (15, 148, (0.0624, 0.1605)),
        (0, 20, (0.0000, 0.1611)),
        (1, 29, (0.0061, 0.1718)),
    ],
)
def test_the_interval_of_a_share_is_wilsons(count, trials, expected):
    assert wilson_interval(count, trials) == pytest.approx(expected, abs=5e-5)
    low, high = wilson_interval(trials - count, trials)
    assert (1 - high, 1 - low) == pytest.approx(expected, abs=5e-5)
