"""Intervals and tests of experiments, with numbers worked out by hand or by SciPy."""

import sys

import numpy as np
import pytest
from scipy import stats

from dppo.experiment.significance import (
    Ratio,
    brown_forsythe,
    equal_spreads_of,
    has_tests,
    interval_of_seeds,
    mann_whitney,
    power_of_brown_forsythe,
    ratio,
    ratio_over,
    share_interval,
    spread_ratio_interval,
    welch,
    welch_of,
)
from dppo.experiment.statistics import (
    cvar10,
    improvement,
    improvement_interval,
    interquartile_mean,
    interval,
    mean,
    resampled,
    resampled_nested,
)
from dppo.statistics import spread

FIVE = np.array([3.0, 1.0, 100.0, 2.0, -50.0])
OTHERS = np.array([10.0, 12.0, 17.0, 9.0, 30.0])


def test_the_interquartile_mean_leaves_out_a_quarter_at_each_end():
    assert interquartile_mean(FIVE) == 2.0  # ⌊5/4⌋ = 1: without -50 and 100
    assert interquartile_mean(np.arange(8.0)) == 3.5  # 2, 3, 4, 5
    assert interquartile_mean(np.array([1.0, 2.0, 6.0])) == 3.0  # ⌊3/4⌋ = 0: the mean
    sample = np.random.default_rng(1).normal(size=41)
    assert interquartile_mean(sample) == pytest.approx(stats.trim_mean(sample, 0.25), rel=1e-12)


def test_the_worst_tenth_is_of_at_least_one_and_rounded_up():
    assert cvar10(np.array([4.0, 1.0, 7.0])) == 1.0
    assert cvar10(np.arange(20.0)) == 0.5  # of 0 and 1
    assert cvar10(np.arange(21.0)) == 1.0  # ⌈2.1⌉ = 3: of 0, 1 and 2


def test_the_spread_is_that_of_a_sample_and_none_of_one():
    assert spread(np.array([1.0, 3.0])) == pytest.approx(np.sqrt(2))
    assert spread(np.array([[5.0]])) == [0.0]
    assert spread(np.array([np.full(100, 1000.1), np.arange(100.0)])).tolist()[0] == 0.0


def test_statistics_go_along_the_last_axis():
    rows = np.array([FIVE, OTHERS])
    for statistic in (mean, spread, interquartile_mean, cvar10):
        assert statistic(rows).tolist() == [statistic(FIVE), statistic(OTHERS)]


def test_the_probability_of_improvement_counts_pairs_and_half_of_the_ties():
    assert improvement(np.array([1.0, 2.0]), np.array([0.0, 2.0])) == 0.625  # (1 + 0 + 1 + .5) / 4
    u = stats.mannwhitneyu(FIVE, OTHERS).statistic
    assert improvement(FIVE, OTHERS) == pytest.approx(u / 25)
    bounds = improvement_interval(FIVE, OTHERS, "x")
    assert bounds is not None
    low, high = bounds
    assert 0 <= low <= improvement(FIVE, OTHERS) <= high <= 1


def test_welch_is_scipys_and_its_interval_is_worked_out_from_the_t_distribution():
    found = welch(OTHERS, FIVE)
    assert found is not None
    assert found.p == pytest.approx(stats.ttest_ind(OTHERS, FIVE, equal_var=False).pvalue)
    a, b = OTHERS.var(ddof=1) / 5, FIVE.var(ddof=1) / 5
    freedom = (a + b) ** 2 / (a**2 / 4 + b**2 / 4)
    half = stats.t.ppf(0.975, freedom) * np.sqrt(a + b)
    assert found.error == pytest.approx((np.sqrt(a + b), freedom))
    assert found.interval == pytest.approx((4.4 - half, 4.4 + half))


def test_brown_forsythe_is_an_analysis_of_variance_of_distances_to_the_medians():
    distances = [np.abs(one - np.median(one)) for one in (FIVE, OTHERS)]
    assert brown_forsythe(FIVE, OTHERS) == pytest.approx(stats.f_oneway(*distances).pvalue)


def test_three_seeds_are_too_few_for_brown_forsythe():
    """However far apart: the largest F there is with three is below the limit."""
    alike, apart = np.array([1.0, 1.0, 1.0]), np.array([-1e6, 0.0, 1e6])
    assert stats.levene(alike, apart).pvalue > 0.05
    assert brown_forsythe(alike, apart) is None
    assert brown_forsythe(np.append(alike, 1.0), np.append(apart, 5.0)) is not None


@pytest.mark.parametrize("scores", [np.array([1.0]), np.array([2.0, 2.0]), np.full(3, 0.1)])
def test_what_cannot_be_tested_is_none(scores):
    assert welch(scores, scores) is None
    assert brown_forsythe(scores, scores) is None


def test_a_ratio_is_of_geometric_means_with_welchs_interval_of_the_logarithms():
    found = ratio(OTHERS, OTHERS[:4] / 2)
    assert found is not None
    assert found.value == pytest.approx(stats.gmean(OTHERS) / stats.gmean(OTHERS[:4] / 2))
    test = stats.ttest_ind(np.log(OTHERS), np.log(OTHERS[:4] / 2), equal_var=False)
    assert found.interval == pytest.approx(tuple(np.exp(test.confidence_interval(0.95))))
    assert ratio(FIVE, OTHERS) is None  # -50 has no logarithm


@pytest.mark.slow
def test_equal_policies_are_told_apart_in_one_of_twenty_cases():
    """What resampled seeds do in one of eight with five seeds."""
    rng = np.random.default_rng(6)
    wrong = 0
    for _ in range(2000):
        found = ratio(*np.exp(rng.normal(0, 0.4, (2, 5))))
        assert found is not None
        assert found.interval is not None
        wrong += not found.interval[0] <= 1 <= found.interval[1]
    assert 0.03 < wrong / 2000 < 0.06


def test_the_ratio_of_spreads_has_the_interval_of_f():
    found = spread_ratio_interval(FIVE, OTHERS)
    assert found is not None
    squared = (FIVE.var(ddof=1) / OTHERS.var(ddof=1)) / stats.f.ppf([0.975, 0.025], 4, 4)
    assert [end**2 for end in found] == pytest.approx(list(squared))


def test_the_power_of_the_test_of_spreads_is_how_often_scipys_rejects():
    rng = np.random.default_rng(7)
    cases = [(0.3 * rng.normal(size=8), rng.normal(size=8)) for _ in range(400)]
    share = np.mean([stats.levene(*case, center="median").pvalue < 0.05 for case in cases])
    assert power_of_brown_forsythe(8, 0.3) == pytest.approx(share, abs=0.07)
    assert power_of_brown_forsythe(3, 0.3) is None


def test_a_share_of_none_or_all_episodes_is_not_certain():
    # Clopper and Pearson: (1 - p)^100 = 0.025
    assert share_interval(np.zeros(1), 100) == pytest.approx((0.0, 1 - 0.025 ** (1 / 100)))
    assert share_interval(np.ones(5), 100) == pytest.approx((0.025 ** (1 / 500), 1.0))
    low, high = share_interval(np.full(3, 0.1), 100) or (0.0, 0.0)  # equal but for rounding
    assert high - low > 0.06
    shares = np.array([0.1, 0.3, 0.2])
    half = stats.t.ppf(0.975, 2) * 0.1 / np.sqrt(3)
    assert share_interval(shares, 100) == pytest.approx((max(0, 0.2 - half), 0.2 + half))


def test_printed_means_and_spreads_can_be_tested_too():
    of = FIVE.mean(), FIVE.std(ddof=1)
    others = OTHERS.mean(), OTHERS.std(ddof=1)
    test = stats.ttest_ind(FIVE, OTHERS, equal_var=False)
    assert welch_of(of, others, 5) == pytest.approx(test.pvalue)
    upper = stats.f.sf(of[1] ** 2 / others[1] ** 2, 4, 4)
    assert equal_spreads_of(others[1], of[1], 5) == pytest.approx(2 * upper)
    assert mann_whitney(FIVE, OTHERS) == pytest.approx(stats.mannwhitneyu(FIVE, OTHERS).pvalue)


def test_without_scipy_there_are_intervals_but_no_tests(monkeypatch):
    monkeypatch.setitem(sys.modules, "scipy", None)
    assert not has_tests()
    assert welch(FIVE, OTHERS) is None
    assert brown_forsythe(FIVE, OTHERS) is None
    assert share_interval(np.zeros(2), 100) is None
    assert ratio(OTHERS, OTHERS) == Ratio(1.0, None)
    assert interval(resampled(FIVE, mean, "x")) is not None


def test_resampling_depends_on_its_label_and_on_nothing_else():
    first = resampled(FIVE, mean, "a")
    resampled(OTHERS, mean, "b")
    assert (resampled(FIVE, mean, "a") == first).all()
    assert (resampled(FIVE, mean, "b") != first).any()


def test_the_interval_of_a_mean_is_close_to_scipys_bootstrap():
    scores = np.random.default_rng(2).normal(5, 2, size=30)
    ours = interval(resampled(scores, mean, "a"))
    theirs = stats.bootstrap(
        (scores,), np.mean, method="percentile", n_resamples=10_000, rng=np.random.default_rng(3)
    ).confidence_interval
    error = 2 / np.sqrt(30) / 10  # a tenth of the standard error
    assert ours == pytest.approx((theirs.low, theirs.high), abs=error)


def test_nested_resampling_shows_the_spread_between_seeds_as_well_as_within():
    generator = np.random.default_rng(4)
    within = generator.normal(size=(5, 100))
    apart = within + 10 * np.arange(5.0)[:, None]  # seeds that differ
    widths = [
        float(np.ptp(np.array(interval(resampled_nested(one, mean, "a")))))
        for one in (within, apart)
    ]
    assert widths[0] < 0.4  # about 4 x 1 / √500 = 0.18
    # the seeds' means 0, 10 .. 40 have a standard deviation of √200: ± 2 x √200 / √5 = ± 12.6
    assert widths[1] == pytest.approx(2 * 1.96 * np.sqrt(200 / 5), rel=0.15)


def test_nested_resampling_of_one_seed_resamples_its_episodes():
    means = resampled_nested(np.array([[0.0, 1.0] * 50]), mean, "one")
    assert means.std() == pytest.approx(0.05, rel=0.1)  # √(.25 / 100)


@pytest.mark.parametrize("which", [0, 1])
def test_the_doubt_about_an_improvement_is_of_both_arms(which):
    arms = [np.array([5.0, 5.0]), np.array([5.0, 5.0])]
    arms[which] = np.array([0.0, 10.0])
    assert improvement_interval(arms[0], arms[1], "x") == (0.0, 1.0)


def test_a_ratio_over_environments_has_students_interval_of_the_logarithms():
    ratios = np.array([0.5, 0.8, 0.4, 1.1])
    found, logs = ratio_over(ratios), np.log(ratios)
    expected = stats.t.interval(0.95, 3, logs.mean(), stats.sem(logs))
    assert found.value == pytest.approx(stats.gmean(ratios))
    assert found.interval == pytest.approx(tuple(np.exp(expected)))
    assert ratio_over(np.full(4, 0.5)) == Ratio(0.5, None)


def test_an_interval_of_what_is_no_number_is_none():
    assert interval(np.array([1.0, np.nan])) is None
    assert interval(np.arange(101.0)) == pytest.approx((2.5, 97.5))


def test_one_environments_interval_by_seeds_is_welchs():
    one = ratio(np.array([2.0, 3.0, 5.0]), OTHERS)
    assert one is not None
    assert one.error is not None
    assert interval_of_seeds(np.array([one.value]), [one.error]) == pytest.approx(one.interval)


def test_over_environments_errors_are_added_by_satterthwaite():
    """Four errors of .5, 8 degrees each: .25 and 32. One far larger one brings its own degrees."""
    low, high = interval_of_seeds(np.full(4, 0.6), [(0.5, 8.0)] * 4) or (0.0, 0.0)
    half = stats.t.ppf(0.975, 32) * 0.25
    assert (low, high) == pytest.approx((0.6 * np.exp(-half), 0.6 * np.exp(half)))
    low, _ = interval_of_seeds(np.ones(2), [(1e-6, 8.0), (0.2, 4.0)]) or (0.0, 0.0)
    assert low == pytest.approx(np.exp(-stats.t.ppf(0.975, 4) * 0.1))
