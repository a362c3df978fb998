"""The figures of an arm on an environment, and of the arm against the baseline."""

from typing import Any

import numpy as np

from dppo.distributions import mean_std
from dppo.experiment.best import best_seed
from dppo.experiment.calibrated import calibration
from dppo.experiment.measure import STARTS, Cell
from dppo.experiment.significance import (
    brown_forsythe,
    mann_whitney,
    ratio,
    share_interval,
    spread_ratio_interval,
    welch,
)
from dppo.experiment.statistics import (
    Floats,
    Interval,
    Statistic,
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

LAST = (200, 100)
"""Training episodes: the paper's measure, and the one of `rollout/ep_rew_mean`."""
MARKS = (1_000_000, 2_000_000, 3_000_000, 5_000_000, 10_000_000)
"""Where returns are told on the way [env steps]."""
GOAL_SPREAD, GOAL_MEAN = 0.7, 0.95
"""What a safe policy's user would want: times the baseline's spread at most, mean at least."""
_WITHIN: dict[str, Statistic] = {"mean": mean, "std": spread, "cvar10": cvar10}
KINDS = {"undiscounted": "return", "discounted": "discounted_return"}
"""Returns of evaluation episodes, and what an episode calls them."""


def summary(cell: Cell) -> dict[str, Any]:
    """One arm on one environment, as results.json has it."""
    return {
        "psi": cell.psi,
        "label": cell.label,
        "is_plain": cell.runs[0].is_plain,
        "settings": dict(cell.runs[0].settings),
        "steps": cell.runs[0].real_steps,
        "seeds_planned": [run.seed for run in cell.runs],
        "seeds": [one.run.seed for one in cell.finished],
        "training": {f"last{count}": training(cell, count) for count in LAST}
        if cell.finished
        else {},
        "on_the_way": on_the_way(cell),
        "moved": moved(cell),
        "evaluation": {
            start: found for start in STARTS if (found := evaluation(cell, start)) is not None
        },
        "calibration": calibration(cell),
        "action_std": action_std(cell),
        "best_seed": best_seed(cell),
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
        "fewest_episodes": min(len(one.returns[-count:]) for one in cell.finished),
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
            found[str(steps)] = {
                "mean": float(scores.mean()), "std_across_seeds": std, "by_seed": _list(scores)
            }  # fmt: skip
    return found


def moved(cell: Cell) -> dict[str, Any]:
    """Where ψ moves, what it came to, and σ(s_0), the mean over start states, with it."""
    found = {}
    for name in ("psi", "start_sigma"):
        values = [one.moved[name] for one in cell.finished if name in one.moved]
        if values:
            found[name] = {"mean": float(np.mean(values)), "by_seed": values}
    return found


def action_std(cell: Cell) -> dict[str, Any] | None:
    """Of final policies, mean over dimensions, and at the start; None: of none that is known."""
    found = [one.evaluation.get("settings", {}).get("action_std") for one in cell.finished]
    stds = [float(std) for std in found if std is not None]
    start = mean_std(np.array([cell.runs[0].config.network.log_std_init], np.float32))
    return {"start": start, "by_seed": stds} if stds else None


def evaluation(cell: Cell, start: str) -> dict[str, Any] | None:
    """Evaluation episodes of the final policies; None: there are none from such starts."""
    returns = cell.evaluated(start, "return")
    if returns is None:
        return None
    found: dict[str, Any] = {"seeds": returns.shape[0], "episodes_per_seed": returns.shape[1]}
    for kind, name in KINDS.items():
        if (values := cell.evaluated(start, name)) is not None:
            found[kind] = _within(values, f"{cell.env}/{cell.arm}/{start}/{kind}")
    lengths, falls = cell.evaluated(start, "length"), cell.evaluated(start, "terminated")
    if lengths is not None:
        found["length_mean"] = float(lengths.mean())
    if falls is not None:
        by_seed = falls.mean(axis=1)
        found["falls"] = float(by_seed.mean())
        found["falls_interval"] = share_interval(by_seed, falls.shape[1])
        found["falls_by_seed"] = _list(by_seed)
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


def comparison(cell: Cell, base: Cell) -> dict[str, Any] | None:
    """An arm against the baseline on the same environment; None: one of them has no seed."""
    if not (cell.finished and base.finished):
        return None
    label = f"{cell.env}/{cell.arm}/{base.arm}"
    found: dict[str, Any] = {
        f"last{count}": _across_seeds(cell, base, count, f"{label}/last{count}") for count in LAST
    }
    found["on_the_way"] = _on_the_way_against(cell, base)
    for start in STARTS:
        if (policies := _policies(cell, base, start)) is not None:
            found[start] = policies
    return found


def _on_the_way_against(cell: Cell, base: Cell) -> dict[str, Any]:
    """Differences of the returns at the marks."""
    found = {}
    for steps in MARKS:
        if steps <= min(cell.runs[0].real_steps, base.runs[0].real_steps):
            ours, theirs = cell.scores_at(steps), base.scores_at(steps)
            if len(ours) and len(theirs):
                found[str(steps)] = _difference(ours, theirs)
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
        "mann_whitney_p": mann_whitney(ours, theirs),
        "brown_forsythe_p": brown_forsythe(ours, theirs),
    }
    if min(len(ours), len(theirs)) > 1:
        found["probability_of_improvement_interval"] = improvement_interval(ours, theirs, label)
        found["stds"] = [float(spread(ours)), float(spread(theirs))]
        found["distances"] = [float(np.abs(one - np.median(one)).mean()) for one in (ours, theirs)]
        found["std_ratio"] = _ratio(*found["stds"])
        found["std_ratio_interval"] = spread_ratio_interval(ours, theirs)
    return found


def _policies(cell: Cell, base: Cell, start: str) -> dict[str, Any] | None:
    """Final policies against the baseline's: one number a seed, Welch's intervals."""
    found: dict[str, Any] = {}
    for kind, name in KINDS.items():
        ours, theirs = cell.evaluated(start, name), base.evaluated(start, name)
        if ours is not None and theirs is not None:
            found["seeds"] = [len(ours), len(theirs)]
            found[kind] = returns_of_policies(ours, theirs)
    if not found:
        return None
    for name in ("terminated", "length"):
        ours, theirs = cell.evaluated(start, name), base.evaluated(start, name)
        if ours is not None and theirs is not None:
            found[name] = _difference(ours.mean(axis=1), theirs.mean(axis=1))
    return found


def returns_of_policies(ours: Floats, theirs: Floats) -> dict[str, Any]:
    """Returns [n, E] of an arm's and [m, E] of the baseline's final policies, one row a seed."""
    found: dict[str, Any] = {"mean_beyond_goal": _beyond_goal(mean(ours), mean(theirs))}
    for name, statistic in _WITHIN.items():
        by_seed = statistic(ours), statistic(theirs)
        found[name] = _difference(*by_seed)
        if name != "cvar10" and (times := ratio(*by_seed)) is not None:
            found[f"{name}_ratio"] = times.value
            found[f"{name}_ratio_interval"] = times.interval
            found[f"{name}_ratio_error"] = times.error
    return found


def _beyond_goal(ours: Floats, theirs: Floats) -> dict[str, Any]:
    """Means of policies over the least that a safe policy may have; also of means below 0."""
    times = GOAL_MEAN if theirs.mean() > 0 else 2 - GOAL_MEAN
    return _difference(ours, times * theirs)


def _difference(ours: Floats, theirs: Floats) -> dict[str, Any]:
    test = welch(ours, theirs)
    return {
        "difference": float(ours.mean() - theirs.mean()),
        "interval": test.interval if test else None,
    }


def _seeds_interval(scores: Floats, statistic: Statistic, label: str) -> Interval | None:
    """None of a single seed: it tells nothing about others."""
    return interval(resampled(scores, statistic, label)) if len(scores) > 1 else None


def _ratio(above: float, below: float) -> float | None:
    return above / below if below > 0 else None


def _list(values: Floats) -> list[float]:
    return [float(value) for value in values]
