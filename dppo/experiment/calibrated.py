"""Whether σ knows how far returns spread: what `dppo eval --calibration` says, over seeds."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from dppo.experiment.measure import Cell

GOAL = 1.25
"""Predicted over empirical standard deviation, or its inverse, at most."""
WITHIN, OUTSIDE, OPEN = "within", "outside", "open"
_RATIOS = {
    "along_ratio": "along",
    "along_squares_ratio": "along_squares",
    "ratio": "start",
}
_OF_STARTS = ("predicted_std", "empirical_std", "squares_std")


def calibration(cell: Cell) -> dict[str, Any] | None:
    """Ratios by seed with their geometric mean, and standard deviations; None: no seed has one."""
    found = [
        one.evaluation["calibration"] for one in cell.finished if "calibration" in one.evaluation
    ]
    if not found:
        return None
    summary: dict[str, Any] = {"lambda_ret": found[0].get("lambda_ret"), "seeds": len(found)}
    for name, short in _RATIOS.items():
        ratios = [one[name] for one in found if _is_number(one.get(name))]
        if ratios:
            with np.errstate(divide="ignore"):  # σ says that nothing spreads: 0
                logs = np.log(ratios)
            summary[short] = {
                "geometric_mean": float(np.exp(np.mean(logs))),
                "by_seed": ratios,
            }
            bounds = [one[f"{name}_interval"] for one in found if one.get(f"{name}_interval")]
            if bounds:
                summary[short]["intervals"] = bounds
                summary[short]["verdicts"] = [_verdict(*ends) for ends in bounds]
    worst = [ratio for one in found if (ratio := _worst(one.get("bins"))) is not None]
    if worst:
        summary["worst_tenth"] = {"by_seed": worst}
    for name in _OF_STARTS:
        stds = [std for one in found if (std := _of_starts(one.get("starts"), name)) is not None]
        if stds:
            summary[name] = {"mean": float(np.mean(stds)), "by_seed": stds}
    return summary


def _verdict(low: float, high: float) -> str:
    """Whether a 95 % interval of a ratio lies within the goal."""
    if low >= 1 / GOAL and high <= GOAL:
        return WITHIN
    return OUTSIDE if low > GOAL or high < 1 / GOAL else OPEN


def _worst(bins: object) -> float | None:
    """Predicted over empirical of the tenth of all steps where it is farthest from 1."""
    ratios = [
        one["predicted_std"] / one["empirical_std"]
        for one in (bins if isinstance(bins, Sequence) else ())
        if one["empirical_std"] > 0
    ]
    return max(ratios, key=lambda ratio: abs(np.log(ratio)) if ratio else np.inf, default=None)


def _of_starts(starts: object, name: str) -> float | None:
    """Root mean square over the start states."""
    if not isinstance(starts, Sequence) or not starts:
        return None
    stds = [one.get(name) for one in starts if isinstance(one, Mapping)]
    if not all(map(_is_number, stds)):
        return None
    return float(np.sqrt(np.mean(np.square(np.array(stds, np.float64)))))


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
