"""Figures and their intervals by resampling. Pure: equal numbers and labels give equal results.

n seeds, E episodes of each, R resamples. Seeds are resampled within one arm on one environment
(stratified); nested resamples draw seeds, and then episodes of each drawn seed. With few seeds
such intervals are too narrow, so nothing is judged by them: see `significance.py`.
"""

import zlib
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from dppo.statistics import tail_mean
from dppo.streams import stream

Floats = NDArray[np.float64]
Interval = tuple[float, float]
Statistic = Callable[[Floats], Floats]
"""Over the last axis."""
RESAMPLES, NESTED_RESAMPLES = 10_000, 2_000
_AT_ONCE = 200
"""Nested resamples: all of many episodes would take gigabytes."""
LEVEL = 0.95


def mean(scores: Floats) -> Floats:
    """Mean over the last axis."""
    return np.asarray(scores.mean(axis=-1))


def interquartile_mean(scores: Floats) -> Floats:
    """Mean over the last axis without its lowest ⌊n/4⌋ and its highest (Agarwal et al. 2021)."""
    count = scores.shape[-1]
    cut = count // 4
    return np.asarray(np.sort(scores, axis=-1)[..., cut : count - cut].mean(axis=-1))


def cvar10(scores: Floats) -> Floats:
    """Mean of the worst tenth over the last axis, of at least one."""
    return tail_mean(scores)


def resampled(scores: Floats, statistic: Statistic, label: str) -> Floats:
    """[R] the statistic of resampled seeds; `label` names the draws, so nothing shifts them."""
    picks = generator(label).integers(len(scores), size=(RESAMPLES, len(scores)))
    return statistic(scores[picks])


def resampled_nested(episodes: Floats, statistic: Statistic, label: str) -> Floats:
    """[R] mean over seeds of a statistic of episodes [n, E], both resampled."""
    draws, (seeds, count) = generator(label), episodes.shape
    values = []
    for _ in range(NESTED_RESAMPLES // _AT_ONCE):
        rows = draws.integers(seeds, size=(_AT_ONCE, seeds, 1))
        columns = draws.integers(count, size=(_AT_ONCE, seeds, count))
        values.append(statistic(episodes[rows, columns]).mean(axis=1))
    return np.concatenate(values)


def interval(values: Floats) -> Interval | None:
    """The middle 95 % of resampled values; None: some of them are no number."""
    if not np.isfinite(values).all():
        return None
    low, high = np.quantile(values, ((1 - LEVEL) / 2, (1 + LEVEL) / 2))
    return float(low), float(high)


def improvement(scores: Floats, others: Floats) -> float:
    """P(X > Y) + P(X = Y) / 2 for one seed of each: Mann and Whitney's U over its maximum."""
    return float(_improvements(scores[None], others[None])[0])


def improvement_interval(scores: Floats, others: Floats, label: str) -> Interval | None:
    """95 % interval of `improvement`, seeds of both resampled."""
    identity: Statistic = lambda drawn: drawn  # noqa: E731
    return interval(
        _improvements(
            resampled(scores, identity, f"{label}/improvement/a"),
            resampled(others, identity, f"{label}/improvement/b"),
        )
    )


def _improvements(scores: Floats, others: Floats) -> Floats:
    """Row by row of [R, n] and [R, m]."""
    found = np.zeros(len(scores))
    for place in range(scores.shape[1]):  # one after the other: all pairs at once are R n m
        gaps = scores[:, place, None] - others
        found += ((gaps > 0) + 0.5 * (gaps == 0)).mean(axis=1)
    return np.asarray(found / scores.shape[1])


def generator(label: str) -> np.random.Generator:
    """A stream of its own for everything that is drawn."""
    return stream(0, "experiment", zlib.crc32(label.encode()))
