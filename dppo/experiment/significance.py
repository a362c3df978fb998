"""Tests and intervals from distributions. Without SciPy, or with too few seeds, they are None.

Of policies, one number a seed is compared (a mean, a standard deviation, a share of episodes), so
that what differs between seeds and what differs between episodes are both in it.
"""

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec

import numpy as np

from dppo.experiment.statistics import LEVEL, Floats, Interval, generator
from dppo.statistics import spread

SIGNIFICANT = 1 - LEVEL
LEAST_FOR_SPREAD = 4
"""With three seeds an arm the Brown-Forsythe test can never reject."""
_SIMULATED = 4000


def has_tests() -> bool:
    """SciPy is installed."""
    return find_spec("scipy") is not None


@dataclass(frozen=True, slots=True)
class Welch:
    """Difference of two means, variances not taken to be equal."""

    interval: Interval
    p: float
    error: tuple[float, float]
    """Standard error of the difference, and its degrees of freedom (Satterthwaite)."""


def welch(scores: Floats, others: Floats) -> Welch | None:
    """Welch's t-test; None: too few seeds, no spread at all, or no SciPy."""
    if min(len(scores), len(others)) < 2 or not has_tests():
        return None
    if max(float(spread(one)) for one in (scores, others)) == 0:
        return None
    from scipy.stats import ttest_ind

    with warnings.catch_warnings():  # the scores of one side may all be the same
        warnings.filterwarnings("ignore", "Precision loss", RuntimeWarning)
        found = ttest_ind(scores, others, equal_var=False)
    low, high = found.confidence_interval(LEVEL)
    error = math.hypot(*(float(spread(one)) / math.sqrt(len(one)) for one in (scores, others)))
    return Welch((float(low), float(high)), float(found.pvalue), (error, float(found.df)))


def welch_of(one: tuple[float, float], other: tuple[float, float], seeds: int) -> float | None:
    """P of Welch's test from means and standard deviations of `seeds` scores each, as printed."""
    if not has_tests():
        return None
    from scipy.stats import ttest_ind_from_stats

    return float(ttest_ind_from_stats(*one, seeds, *other, seeds, equal_var=False).pvalue)


def equal_spreads_of(std: float, other: float, seeds: int) -> float | None:
    """P of the F test, two-sided, from standard deviations of `seeds` normal scores each."""
    if not has_tests():
        return None
    from scipy.stats import f

    above, below = max(std, other), min(std, other)
    return float(2 * f.sf((above / below) ** 2, seeds - 1, seeds - 1))


@dataclass(frozen=True, slots=True)
class Ratio:
    """Of two geometric means over seeds, or over environments."""

    value: float
    interval: Interval | None
    """Welch's or Student's, of the logarithms."""
    error: tuple[float, float] | None = None
    """Of the logarithm: see `Welch`."""


def ratio(scores: Floats, others: Floats) -> Ratio | None:
    """How many times as large the scores are; None: some of them are not above 0."""
    if min(scores.min(), others.min()) <= 0:
        return None
    logs = np.log(scores), np.log(others)
    test = welch(*logs)
    value = math.exp(logs[0].mean() - logs[1].mean())
    if test is None:
        return Ratio(value, None)
    return Ratio(value, (math.exp(test.interval[0]), math.exp(test.interval[1])), test.error)


def ratio_over(ratios: Floats) -> Ratio:
    """Geometric mean of ratios above 0, with Student's interval of their logarithms."""
    logs = np.log(ratios)
    value, error = float(logs.mean()), float(spread(logs)) / math.sqrt(len(logs))
    if len(logs) < 2 or error == 0 or not has_tests():
        return Ratio(math.exp(value), None)
    return Ratio(math.exp(value), _around(value, error, len(logs) - 1))


def interval_of_seeds(ratios: Floats, errors: Sequence[tuple[float, float]]) -> Interval | None:
    """Of the geometric mean of these ratios alone, by what seeds differ: Satterthwaite's.

    `errors` are those of `Ratio`. None: no SciPy.
    """
    if not has_tests():
        return None
    squares = np.array([error**2 for error, _ in errors])
    freedom = squares.sum() ** 2 / (squares**2 / [each for _, each in errors]).sum()
    error = math.sqrt(squares.sum()) / len(ratios)
    return _around(float(np.log(ratios).mean()), error, float(freedom))


def _around(log: float, error: float, freedom: float) -> Interval:
    """Student's interval of a number whose logarithm has this standard error."""
    from scipy.stats import t

    half = float(t.ppf((1 + LEVEL) / 2, freedom)) * error
    return math.exp(log - half), math.exp(log + half)


def brown_forsythe(scores: Floats, others: Floats) -> float | None:
    """P of equal spreads: an analysis of variance of distances to the medians; None as above."""
    if min(len(scores), len(others)) < LEAST_FOR_SPREAD or not has_tests():
        return None
    distances = [np.abs(one - np.median(one)) for one in (scores, others)]
    if all(one.max() == one.min() for one in distances):
        return None
    from scipy.stats import levene

    return float(levene(scores, others, center="median").pvalue)


def spread_ratio_interval(scores: Floats, others: Floats) -> Interval | None:
    """95 % interval of the ratio of two standard deviations, by F: of normal scores."""
    stds = float(spread(scores)), float(spread(others))
    if min(len(scores), len(others)) < 2 or min(stds) <= 0 or not has_tests():
        return None
    from scipy.stats import f

    quantiles = f.ppf([(1 + LEVEL) / 2, (1 - LEVEL) / 2], len(scores) - 1, len(others) - 1)
    low, high = stds[0] / stds[1] / np.sqrt(quantiles)
    return float(low), float(high)


def power_of_brown_forsythe(seeds: int, times: float) -> float | None:
    """How often the test finds that a spread is so many times another's: of normal scores."""
    if seeds < LEAST_FOR_SPREAD or not has_tests():
        return None
    from scipy.stats import f

    drawn = generator(f"power/{seeds}").standard_normal((2, _SIMULATED, seeds))
    drawn[0] *= times
    distances = np.abs(drawn - np.median(drawn, axis=-1, keepdims=True))
    between = seeds * distances.mean(axis=-1).var(axis=0, ddof=1)
    within = distances.var(axis=-1, ddof=1).mean(axis=0)
    return float((between / within > f.ppf(LEVEL, 1, 2 * seeds - 2)).mean())


def mann_whitney(scores: Floats, others: Floats) -> float | None:
    """P of neither being larger by chance, exact where no scores are equal; None as above."""
    if min(len(scores), len(others)) < 2 or not has_tests():
        return None
    from scipy.stats import mannwhitneyu

    return float(mannwhitneyu(scores, others).pvalue)


def share_interval(by_seed: Floats, episodes: int) -> Interval | None:
    """95 % interval of a share of episodes.

    Student's over seeds. Where all seeds have the same share, or there is one seed, the exact one
    (Clopper and Pearson) of all episodes together: none of 100 allows for 3.6 %.
    """
    if not has_tests():
        return None
    from scipy.stats import binomtest, t

    seeds, share = len(by_seed), float(by_seed.mean())
    error = float(spread(by_seed)) / math.sqrt(seeds)
    if error > 0:
        half = float(t.ppf((1 + LEVEL) / 2, seeds - 1)) * error
        return max(0.0, share - half), min(1.0, share + half)
    trials = seeds * episodes
    found = binomtest(round(share * trials), trials).proportion_ci(LEVEL, method="exact")
    return float(found.low), float(found.high)
