"""An arm against the baseline on all environments at once: one ratio per environment.

Five seeds show little about a spread on one environment; what all environments say together shows
more. Student's t of the logarithms of the ratios asks whether they lie to one side of 1, as far as
the environments are a sample of those that one cares about.
"""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from dppo.experiment.significance import ratio_over

FEWEST = 3
"""Environments."""
_MEASURES = {
    "across": ("last200", None, "std_ratio"),
    "within": ("free", "undiscounted", "std_ratio"),
    "within_mean": ("free", "undiscounted", "mean_ratio"),
    "within_discounted": ("free", "discounted", "std_ratio"),
    "within_discounted_mean": ("free", "discounted", "mean_ratio"),
}
"""Spread across seeds; spread within a policy and the mean there: where a comparison has them."""


def together(environments: Mapping[str, Any], baseline: str) -> dict[str, Any]:
    """Of each arm but the baseline, the measures that all environments have.

    Args:
        environments: those of results.json, at least `FEWEST`; else nothing is said.
        baseline: key of the arm that the others are compared with.
    """
    arms = dict.fromkeys(arm for one in environments.values() for arm in one["arms"])
    found = {
        arm: dict(_measures([one["arms"].get(arm) for one in environments.values()]))
        for arm in arms
        if arm != baseline and len(environments) >= FEWEST
    }
    return {arm: measures for arm, measures in found.items() if measures}


def _measures(arms: list[Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    for name, (part, kind, key) in _MEASURES.items():
        ratios = [_ratio(arm, part, kind, key) for arm in arms]
        if all(ratio is not None and ratio > 0 for ratio in ratios):
            one = ratio_over(np.array(ratios))
            yield (
                name,
                {"ratio": one.value, "interval": one.interval, "environments": len(ratios)},
            )


def _ratio(arm: Any, part: str, kind: str | None, key: str) -> float | None:  # noqa: ANN401  JSON
    if not arm or not arm.get("against_baseline"):
        return None
    found = arm["against_baseline"].get(part, {})
    if min(found.get("seeds", [0])) < 2:
        return None
    ratio: float | None = (found if kind is None else found.get(kind, {})).get(key)
    return ratio
