"""The figures of an arm on an environment, and of the arm against the baseline."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from dppo.experiment.measure import Cell
from dppo.experiment.statistics import (
    Floats,
    Interval,
    Statistic,
    brown_forsythe,
    cvar10,
    improvement,
    improvement_interval,
    interquartile_mean,
    interval,
    mean,
    resampled,
    resampled_nested,
    spread,
    welch,
)

LAST = (200, 100)
"""Training episodes: the paper's measure, and the one of `rollout/ep_rew_mean`."""
MARKS = (1_000_000, 2_000_000, 3_000_000, 5_000_000, 10_000_000)
"""Where returns are told on the way [env steps]."""
STARTS = ("free", "fixed")
_WITHIN: dict[str, Statistic] = {"mean": mean, "std": spread, "cvar10": cvar10}


def summary(cell: Cell) -> dict[str, Any]:
    """One arm on one environment, as results.json has it."""
    return {
        "psi": cell.psi,
        "label": cell.label,
        "settings": dict(cell.runs[0].settings),
        "steps": cell.runs[0].real_steps,
        "seeds_planned": [run.seed for run in cell.runs],
        "seeds": [one.run.seed for one in cell.finished],
        "training": {f"last{count}": training(cell, count) for count in LAST}
        if cell.finished
        else {},
        "on_the_way": on_the_way(cell),
        "evaluation": {
            start: found for start in STARTS if (found := evaluation(cell, start)) is not None
        },
        "calibration": calibration(cell),
        "parameters_sha256": {
            str(one.run.seed): one.result.get("parameters_sha256") for one in cell.finished
        },
        "exact": all(one.result.get("exact", False) for one in cell.finished),
        "restarts": sum(int(one.result.get("restarts", 0)) for one in cell.finished),
    }


def training(cell: Cell, count: int) -> dict[str, Any]:
    """Mean return of the last training episodes: over seeds, with intervals."""
    scores, label = cell.scores(count), f"{cell.env}/{cell.arm}/last{count}"
    several = len(scores) > 1
    pooled = np.concatenate([one.returns[-count:] for one in cell.finished])
    return {
        "by_seed": _list(scores),
        "mean": float(scores.mean()),
        "std_across_seeds": float(spread(scores)) if several else None,
        "std_of_all_episodes": float(spread(pooled)),
        "mean_interval": _seeds_interval(scores, mean, f"{label}/mean"),
        "iqm": float(interquartile_mean(scores)),
        "iqm_interval": _seeds_interval(scores, interquartile_mean, f"{label}/iqm"),
    }


def on_the_way(cell: Cell) -> dict[str, Any]:
    """Mean over seeds of the last 100 training episodes' mean return, at some steps of the run."""
    found = {}
    for steps in MARKS:
        if steps <= cell.runs[0].real_steps and len(scores := cell.scores_at(steps)):
            std = float(spread(scores)) if len(scores) > 1 else None
            found[str(steps)] = {"mean": float(scores.mean()), "std_across_seeds": std}
    return found


def evaluation(cell: Cell, start: str) -> dict[str, Any] | None:
    """Evaluation episodes of the final policies; None: there are none from such starts."""
    returns = cell.evaluated(start, "return")
    if returns is None:
        return None
    label = f"{cell.env}/{cell.arm}/{start}"
    found: dict[str, Any] = {
        "seeds": returns.shape[0],
        "episodes_per_seed": returns.shape[1],
        "undiscounted": _within(returns, label),
        "length_mean": _mean_of(cell.evaluated(start, "length")),
    }
    discounted = cell.evaluated(start, "discounted_return")
    if discounted is not None:
        found["discounted"] = _within(discounted, f"{label}/discounted")
    falls = cell.evaluated(start, "terminated")
    if falls is not None:
        found["falls"] = float(falls.mean())
        found["falls_interval"] = interval(resampled_nested(falls, mean, f"{label}/falls"))
        found["falls_by_seed"] = _list(falls.mean(axis=1))
    return found


def _within(returns: Floats, label: str) -> dict[str, Any]:
    """[n, E] returns: figures of each seed's policy, their mean over seeds, nested intervals."""
    found: dict[str, Any] = {"worst": float(returns.min())}
    for name, statistic in _WITHIN.items():
        by_seed = statistic(returns)
        found[name] = float(by_seed.mean())
        found[f"{name}_interval"] = interval(
            resampled_nested(returns, statistic, f"{label}/{name}")
        )
        found[f"{name}_by_seed"] = _list(by_seed)
    return found


def calibration(cell: Cell) -> dict[str, Any] | None:
    """Mean over seeds of each number of `dppo eval`'s calibration; None: no seed has one."""
    found = [
        _flat(one.evaluation["calibration"])
        for one in cell.finished
        if "calibration" in one.evaluation
    ]
    if not found:
        return None
    names = [name for name, value in found[0].items() if _is_number(value)]
    return {
        name: {"mean": float(np.mean(values)), "by_seed": values}
        for name in names
        if len(values := [one[name] for one in found if _is_number(one.get(name))]) == len(found)
    }


def _flat(values: Mapping[str, Any]) -> dict[str, Any]:
    """With the standard deviations from the start states: root mean squares over those."""
    starts = values.get("starts")
    if not isinstance(starts, list | tuple) or not starts:
        return dict(values)
    found = {}
    for name in ("predicted_std", "empirical_std"):
        stds = [one.get(name) for one in starts]
        if all(map(_is_number, stds)):
            found[name] = float(np.sqrt(np.mean(np.square(stds))))
    return found | dict(values)


def comparison(cell: Cell, base: Cell) -> dict[str, Any] | None:
    """An arm against the baseline on the same environment; None: one of them has no seed."""
    if not (cell.finished and base.finished):
        return None
    label = f"{cell.env}/{cell.arm}/{base.arm}"
    found: dict[str, Any] = {
        f"last{count}": _across_seeds(cell, base, count, f"{label}/last{count}") for count in LAST
    }
    for start in STARTS:
        pair = cell.evaluated(start, "return"), base.evaluated(start, "return")
        if pair[0] is not None and pair[1] is not None:
            found[start] = _policies(pair[0], pair[1], f"{label}/{start}")
    return found


def _across_seeds(cell: Cell, base: Cell, count: int, label: str) -> dict[str, Any]:
    ours, theirs = cell.scores(count), base.scores(count)
    test = welch(ours, theirs)
    found: dict[str, Any] = {
        "seeds": [len(ours), len(theirs)],
        "difference": float(ours.mean() - theirs.mean()),
        "welch_interval": test.interval if test else None,
        "welch_p": test.p if test else None,
        "probability_of_improvement": improvement(ours, theirs),
        "brown_forsythe_p": brown_forsythe(ours, theirs),
    }
    if min(len(ours), len(theirs)) > 1:
        pair = [
            resampled(scores, mean, f"{label}/mean/{side}")
            for side, scores in (("a", ours), ("b", theirs))
        ]
        found["difference_interval"] = interval(pair[0] - pair[1])
        found["probability_of_improvement_interval"] = improvement_interval(ours, theirs, label)
        found["std_ratio"] = _ratio(float(spread(ours)), float(spread(theirs)))
    return found


def _policies(ours: Floats, theirs: Floats, label: str) -> dict[str, Any]:
    """Spread within a policy and mean as ratios, CVaR as a difference; nested intervals."""
    found: dict[str, Any] = {}
    for name, statistic in _WITHIN.items():
        drawn = [
            resampled_nested(returns, statistic, f"{label}/{name}/{side}")
            for side, returns in (("a", ours), ("b", theirs))
        ]
        values = [float(statistic(returns).mean()) for returns in (ours, theirs)]
        found[f"{name}_difference"] = values[0] - values[1]
        found[f"{name}_difference_interval"] = interval(drawn[0] - drawn[1])
        if name != "cvar10" and (drawn[1] > 0).all():
            found[f"{name}_ratio"] = _ratio(*values)
            found[f"{name}_ratio_interval"] = interval(drawn[0] / drawn[1])
    return found


def _seeds_interval(scores: Floats, statistic: Statistic, label: str) -> Interval | None:
    """None of a single seed: it tells nothing about others."""
    return interval(resampled(scores, statistic, label)) if len(scores) > 1 else None


def _ratio(above: float, below: float) -> float | None:
    return above / below if below > 0 else None


def _mean_of(values: Floats | None) -> float | None:
    return None if values is None else float(values.mean())


def _list(values: Floats) -> list[float]:
    return [float(value) for value in values]


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
