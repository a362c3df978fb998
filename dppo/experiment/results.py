"""`results.json`: every number of an experiment, and what it was run with."""

import platform
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np

from dppo.experiment.compare import comparison, summary
from dppo.experiment.folder import Folder, Plan
from dppo.experiment.measure import Cell, cells
from dppo.experiment.statistics import (
    LEVEL,
    NESTED_RESAMPLES,
    RESAMPLES,
    Floats,
    has_tests,
    interquartile_mean,
    interval,
    resampled,
)

Results = dict[str, Any]
_PACKAGES = ("dppo", "numpy", "scipy", "matplotlib")


def describe(folder: Folder, plan: Plan) -> tuple[Results, list[Cell]]:
    """The whole grid as far as it has come."""
    grid = plan.grid
    found = cells(folder, grid)
    failures = {
        name: why for name, why in folder.failures().items() if _is_open(folder, plan, name)
    }
    trained = [run.name for run in grid.runs if folder.is_trained(run)]
    results: Results = {
        "title": grid.title,
        "status": "whole" if len(trained) == len(grid.runs) else "partial",
        "runs": {
            "planned": len(grid.runs),
            "finished": len(trained),
            "failed": failures,
            "missing": [
                run.name
                for run in grid.runs
                if run.name not in trained and run.name not in failures
            ],
        },
        "baseline": grid.baseline,
        "evaluation_episodes": grid.evaluate,
        "environments": _environments(found, grid.baseline),
        "over_environments": over_environments(found, grid.baseline),
        "intervals": {
            "level": LEVEL,
            "resamples": RESAMPLES,
            "nested_resamples": NESTED_RESAMPLES,
            "tests": has_tests(),
        },
        "commands": {run.name: ["dppo-learner", *run.words] for run in grid.runs},
        "sessions": [dict(one) for one in plan.sessions],
        "versions": _versions(found),
    }
    return results, found


def _is_open(folder: Folder, plan: Plan, name: str) -> bool:
    """A failure that was noted is not over, by a later start, since."""
    run = next((run for run in plan.grid.runs if run.name == name), None)
    return run is not None and not folder.is_evaluated(run, plan.grid.evaluate)


def _environments(found: Sequence[Cell], baseline: str) -> dict[str, Any]:
    environments: dict[str, Any] = {}
    for cell in found:
        arms = environments.setdefault(cell.env, {"arms": {}})["arms"]
        arms[cell.arm] = summary(cell)
        base = next((one for one in found if (one.env, one.arm) == (cell.env, baseline)), None)
        if base is not None and cell.arm != baseline:
            arms[cell.arm]["against_baseline"] = comparison(cell, base)
    return environments


def over_environments(found: Sequence[Cell], baseline: str) -> dict[str, Any]:
    """Interquartile mean over environments and seeds, scores in units of the baseline's mean.

    Of each arm that every environment has, with seeds resampled within each environment (Agarwal
    et al. 2021). Empty with one environment, or where a baseline's mean is not above 0.
    """
    envs = list(dict.fromkeys(cell.env for cell in found))
    by_key = {(cell.env, cell.arm): cell for cell in found if cell.finished}
    units = {
        env: float(by_key[env, baseline].scores(100).mean())
        for env in envs
        if (env, baseline) in by_key
    }
    if len(envs) < 2 or len(units) < len(envs) or min(units.values()) <= 0:
        return {}
    return {
        arm: _together([by_key[env, arm].scores(100) / units[env] for env in envs], arm)
        for arm in dict.fromkeys(cell.arm for cell in found)
        if all((env, arm) in by_key for env in envs)
    }


def _together(scores: list[Floats], arm: str) -> dict[str, Any]:
    drawn = [
        resampled(one, lambda values: values, f"over/{arm}/{place}")
        for place, one in enumerate(scores)
    ]
    several = min(map(len, scores)) > 1
    values = interquartile_mean(np.concatenate(drawn, axis=1))
    return {
        "iqm": float(interquartile_mean(np.concatenate(scores))),
        "iqm_interval": interval(values) if several else None,
    }


def _versions(found: Sequence[Cell]) -> dict[str, Any]:
    """Of this report, and of the runs: more than one of a kind if they differ."""
    runs: dict[str, set[str]] = {}
    for one in (one for cell in found for one in cell.finished):
        for name, number in one.facts.get("versions", {}).items():
            runs.setdefault(name, set()).add(number)
    ours = {name: _version(name) for name in _PACKAGES}
    return {
        "report": {"python": platform.python_version(), **ours},
        "runs": {name: sorted(numbers) for name, numbers in runs.items()},
    }


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None
