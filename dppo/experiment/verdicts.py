"""Sentences of judgement, computed from intervals and tests."""

from collections.abc import Mapping
from typing import Any

from dppo.experiment.compare import GOAL_SPREAD
from dppo.experiment.significance import LEAST_FOR_SPREAD, SIGNIFICANT, has_tests

ONE_SEED = "one seed shows nothing"
Summary = Mapping[str, Any]


def of_interval(interval: Any, seeds: int, *, zero: float = 0.0) -> str:  # noqa: ANN401  JSON
    """`higher` or `lower` if the interval leaves out "no difference"."""
    if seeds < 2:
        return ONE_SEED
    if interval is None:
        return "not judged: no interval"
    return _side(interval, zero, f"no difference that {seeds} seeds can show")


def of_mean(comparison: Summary) -> str:
    """Mean return against the baseline's: Welch's interval."""
    found = comparison["last200"]
    return of_interval(found["welch_interval"], min(found["seeds"]))


def of_spread(comparison: Summary) -> str:
    """Spread across seeds against the baseline: the Brown-Forsythe test."""
    found = comparison["last200"]
    seeds, p = min(found["seeds"]), found["brown_forsythe_p"]
    if seeds < 2:
        return ONE_SEED
    if p is None:
        return f"not judged: {_why_no_test(found)}"
    if not p < SIGNIFICANT:  # nor is nan
        return f"no difference that {seeds} seeds can show"
    (ours, theirs), (near, far) = found["stds"], found["distances"]
    if (ours < theirs) != (near < far):
        return "not judged: standard deviations and distances to the medians disagree"
    return "lower" if ours < theirs else "higher"


def _why_no_test(found: Summary) -> str:
    """Of spreads across seeds."""
    if min(found["seeds"]) < LEAST_FOR_SPREAD:
        return f"fewer than {LEAST_FOR_SPREAD} seeds"
    return "seeds differ from their median all by the same" if has_tests() else "no SciPy"


def of_ratio(found: Any) -> str:  # noqa: ANN401  JSON
    """A ratio over environments; None: there is none."""
    if found is None or found["interval"] is None:
        return "not judged: no interval"
    side = _side(found["interval"], 1.0, "no difference that these environments show together")
    by_seeds = found.get("interval_of_seeds")
    if by_seeds is not None and side in ("higher", "lower") and _side(by_seeds, 1.0, "") != side:
        return f"{side} with environments as the sample, not by what seeds differ"
    return side


def _side(interval: Any, zero: float, neither: str) -> str:  # noqa: ANN401  JSON
    """On which side of "no difference" an interval lies."""
    low, high = interval
    if low > zero:
        return "higher"
    return "lower" if high < zero else neither


def of_policies(comparison: Summary, start: str, kind: str) -> str:
    """Spread of returns within a policy, and what it costs in mean, against the baseline."""
    found, seeds = comparison[start][kind], min(comparison[start]["seeds"])
    mean = of_interval(found["mean"]["interval"], seeds)
    return f"spread {of_spread_within(found, seeds)}; mean {mean}"


def of_spread_within(found: Summary, seeds: int) -> str:
    """Spread of one policy's returns: by the ratio, or where a policy has none, the difference."""
    if "std_ratio" in found:
        return of_interval(found["std_ratio_interval"], seeds, zero=1.0)
    return of_interval(found["std"]["interval"], seeds)


def of_falls(policies: Summary) -> str:
    """Share of episodes that ended in falls, of final policies from one kind of start."""
    return of_interval(policies["terminated"]["interval"], min(policies["seeds"]))


def of_goal(comparison: Summary, start: str, kind: str) -> str:
    """Is the spread within a policy 30 % lower, for at most 5 % of the mean?"""
    found = comparison[start][kind]
    if min(comparison[start]["seeds"]) < 2:
        return ONE_SEED
    spread, mean = found.get("std_ratio_interval"), found["mean_beyond_goal"]["interval"]
    if spread is None or mean is None:
        return "not judged: no interval"
    if spread[1] <= GOAL_SPREAD and mean[0] >= 0:
        return "yes"
    if spread[0] > GOAL_SPREAD or mean[1] < 0:
        return "no"
    reached = found["std_ratio"] <= GOAL_SPREAD and found["mean_beyond_goal"]["difference"] >= 0
    return f"open; the estimate {'reaches' if reached else 'misses'} it"
