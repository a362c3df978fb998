"""How far the returns of an episode go from V, step by step; see `calibration.py`."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Float64 = NDArray[np.float64]
_UNSEEN = 0.01
"""Largest share γ̄^l of σ that may lie beyond a time limit l steps ahead."""


@dataclass(frozen=True, slots=True)
class Spread:
    """One episode."""

    sigma: Float64  # [T]  σ(s_t), reward²
    error: Float64  # [T]  G_t − V(s_t), reward
    squares: Float64  # [T]  Σ γ̄^l δ_{t+l}², reward²
    discounted: float
    is_cut: bool
    """By a time limit that neither V nor σ know of."""
    shown: int = 0
    """Steps whose σ can show before a time limit."""


def far_from_limits(
    found: Mapping[tuple[int, int], Spread], discount: float
) -> dict[tuple[int, int], Spread]:
    """The same episodes, each with the steps that are so far from a time limit.

    So far that γ̄^l, with γ̄ the `discount`, is small. The limit is where the longest of those that
    were cut ended.
    """
    beyond = _steps_beyond(discount)
    limit = max((len(one.sigma) for one in found.values() if one.is_cut), default=None)
    episodes = {}
    for key, one in found.items():
        steps = len(one.sigma)
        end = steps if one.is_cut else limit
        shown = steps if end is None else max(0, min(steps, end - beyond))
        episodes[key] = replace(one, shown=shown)
    return episodes


def _steps_beyond(discount: float) -> int:
    """L such that γ̄^l is small."""
    if discount in (0.0, 1.0):
        return int(discount) * np.iinfo(np.int64).max
    return int(np.ceil(np.log(_UNSEEN) / np.log(discount)))
