"""Figures of sets of returns, and how far they are to be trusted."""

import math
from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

Float64 = NDArray[np.float64]
Measure = Callable[[Float64], Float64]
"""A figure of each row of values [..., N]."""
RESAMPLES = 2000
_Z = 1.959964
"""A normal variable is within so many standard deviations of its mean in 95 of 100 cases."""
_ROUNDING = 1e-12
_AT_ONCE = 1_000_000
"""Numbers drawn at a time: 8 MB."""


def tail_mean(values: Float64, fraction: float = 0.1) -> Float64:
    """[...] mean of the worst `fraction` of values [..., N], of at least one."""
    count = max(1, int(np.ceil(fraction * values.shape[-1])))
    mean: Float64 = np.sort(values, axis=-1)[..., :count].mean(axis=-1)
    return mean


def spread(values: Float64) -> Float64:
    """[...] standard deviation of a sample [..., N], with N - 1; 0 of a single one.

    Values that differ by rounding alone are the same: 0.
    """
    if values.shape[-1] < 2:
        return np.zeros(values.shape[:-1])
    same = np.ptp(values, axis=-1) <= _ROUNDING * np.abs(values).max(axis=-1)
    return np.where(same, 0.0, values.std(axis=-1, ddof=1))


def cvar(returns: Float64, fraction: float = 0.1) -> float:
    """Conditional value at risk: mean of the worst `fraction` of the returns, of at least one."""
    return float(tail_mean(returns, fraction))


def wilson_interval(count: int, trials: int) -> tuple[float, float]:
    """95 % interval of a share of which `count` of some trials are known: Wilson (1927).

    It has a width where all trials or none count, and a bootstrap has none: none of 100 allows
    for 3.7 %.
    """
    share, square = count / trials, _Z**2 / trials
    middle = (share + square / 2) / (1 + square)
    half = math.sqrt(share * (1 - share) * square + square**2 / 4) / (1 + square)
    return max(0.0, middle - half), min(1.0, middle + half)


def intervals(
    values: Float64, measures: Mapping[str, Measure], rng: np.random.Generator
) -> dict[str, tuple[float, float]]:
    """95 % bootstrap intervals of some figures of the same values [N] or [N, F].

    The percentile method: figures of 2000 samples of N values, drawn with replacement, lie between
    these bounds in 95 of 100 cases. All figures are of the same samples. N is the first axis; a
    measure gets [..., N], or [..., F, N]. A bound among samples whose figure is inf is not finite.
    """
    count = len(values)
    rows = max(1, _AT_ONCE // max(1, values.size))
    found: dict[str, list[Float64]] = {name: [] for name in measures}
    for first in range(0, RESAMPLES, rows):
        drawn = rng.integers(count, size=(min(rows, RESAMPLES - first), count))
        sample = np.moveaxis(values[drawn], 1, -1)
        for name, measure in measures.items():
            found[name].append(measure(sample))
    with np.errstate(invalid="ignore"):  # between inf and inf
        bounds = {
            name: np.quantile(np.concatenate(parts), (0.025, 0.975))
            for name, parts in found.items()
        }
    return {name: (float(low), float(high)) for name, (low, high) in bounds.items()}
