"""An arm against the baseline on all environments at once: one ratio per environment.

Five seeds show little about a spread on one environment; what all environments say together shows
more. Two intervals say how sure it is: Student's t of the logarithms of the ratios, as far as the
environments are a sample of those that one cares about; and, of these environments alone, by how
seeds differ. The first is too narrow where ratios agree by chance.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from dppo.experiment.significance import interval_of_seeds, ratio_over

FEWEST = 3
"""Environments."""
WITHIN_POLICIES = {"undiscounted": "within", "discounted": "within_discounted"}
"""What the spread within a policy is called among the measures, by what returns it is of; the mean
there has `_mean` behind."""
_MEASURES = {
    "across": ("last200", None, "std_ratio"),
    **{
        name + suffix: ("free", kind, ratio)
        for kind, name in WITHIN_POLICIES.items()
        for suffix, ratio in (("", "std_ratio"), ("_mean", "mean_ratio"))
    },
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
        arm: measures([one["arms"].get(arm) for one in environments.values()])
        for arm in arms
        if arm != baseline
    }
    return {arm: one for arm, one in found.items() if one}


def measures(arms: Sequence[Any]) -> dict[str, dict[str, Any]]:
    """Of an arm on each of some environments, what all of them have; of too few, nothing."""
    return dict(_measures(arms)) if len(arms) >= FEWEST else {}


def _measures(arms: Sequence[Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    for name, (part, kind, key) in _MEASURES.items():
        found = [_compared(arm, part, kind) for arm in arms]
        ratios = np.array([one.get(key) or 0.0 for one in found])
        if ratios.min() > 0:
            one = ratio_over(ratios)
            errors = [error for each in found if (error := each.get(f"{key}_error"))]
            is_known = len(errors) == len(ratios)
            yield (
                name,
                {
                    "ratio": one.value,
                    "interval": one.interval,
                    "interval_of_seeds": interval_of_seeds(ratios, errors) if is_known else None,
                    "environments": len(ratios),
                },
            )


def _compared(arm: Any, part: str, kind: str | None) -> Mapping[str, Any]:  # noqa: ANN401  JSON
    """Of an arm against the baseline; empty: too few seeds."""
    found: Mapping[str, Any] = ((arm or {}).get("against_baseline") or {}).get(part, {})
    if min(found.get("seeds", [0])) < 2:
        return {}
    return found if kind is None else found.get(kind, {})
