"""`results.json`: every number of an experiment, and what it was run with."""

import platform
from collections.abc import Collection, Sequence
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np

from dppo.experiment.compare import comparison, summary
from dppo.experiment.folder import Folder, Plan
from dppo.experiment.measure import Cell, cells
from dppo.experiment.paper import reported
from dppo.experiment.plan import Grid
from dppo.experiment.significance import has_tests
from dppo.experiment.statistics import (
    LEVEL,
    NESTED_RESAMPLES,
    RESAMPLES,
    Floats,
    interquartile_mean,
    interval,
    mean,
    resampled,
)
from dppo.experiment.together import together
from dppo.presets import PRESETS

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
    described = [one for cell in found for one in cell.finished]
    unevaluated = [
        run.name
        for run in grid.runs
        if run.name in trained and not folder.is_evaluated(run, grid.evaluate)
    ]
    environments = _environments(found, grid.baseline)
    results: Results = {
        "title": grid.title,
        "status": _status(grid, {*trained} - {*unevaluated}, failures),
        "runs": {
            "planned": len(grid.runs),
            "finished": len(trained),
            "without_episodes": [
                name for name in trained if name not in {one.run.name for one in described}
            ],
            "not_evaluated": unevaluated,
            "failed": failures,
            "missing": [
                run.name
                for run in grid.runs
                if run.name not in trained and run.name not in failures
            ],
        },
        "baseline": grid.baseline,
        "evaluation_episodes": grid.evaluate,
        "environments": environments,
        "over_environments": over_environments(found, grid.baseline),
        "together": together(environments, grid.baseline),
        "intervals": {
            "level": LEVEL,
            "resamples": RESAMPLES,
            "nested_resamples": NESTED_RESAMPLES,
            "tests": has_tests(),
        },
        "unlike_the_paper": _unlike_the_paper(found),
        "run_otherwise": _run_otherwise(found),
        "commands": {run.name: ["dppo-learner", *run.words] for run in grid.runs},
        "sessions": [dict(one) for one in plan.sessions],
        "versions": _versions(found),
    }
    return results, found


def _status(grid: Grid, done: Collection[str], failed: Collection[str]) -> str:
    """Whole; over, but for runs that have failed; or partial: something is still to come."""
    if len(done) == len(grid.runs):
        return "whole"
    over = all(run.name in done or run.name in failed for run in grid.runs)
    return "over, with failures" if over else "partial"


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
    et al. 2021), the baseline's along with the arm's: its mean is as uncertain. Of the seeds that
    all environments have, so that each counts as much. Empty with one environment, fewer than two
    seeds, or where a baseline's mean is not above 0; no interval where a resampled one is not.
    """
    envs = list(dict.fromkeys(cell.env for cell in found))
    by_key = {(cell.env, cell.arm): cell for cell in found if cell.finished}
    scores_of = {}
    for arm in dict.fromkeys(cell.arm for cell in found):
        cells_ = [by_key.get((env, arm)) for env in envs]
        scores_of[arm] = _of_common_seeds([cell for cell in cells_ if cell is not None])
        if None in cells_:
            del scores_of[arm]
    bases = scores_of.get(baseline)
    if len(envs) < 2 or bases is None or len(bases[0]) < 2 or min(map(np.mean, bases)) <= 0:
        return {}
    return {
        arm: _in_units(scores, bases, arm, is_base=arm == baseline)
        for arm, scores in scores_of.items()
        if len(scores[0]) > 1
    }


def _of_common_seeds(cells_: Sequence[Cell]) -> list[Floats]:
    """Last 100 training episodes on each environment, of the seeds that all of them have."""
    seeds = [{one.run.seed for one in cell.finished} for cell in cells_]
    common = set.intersection(*seeds) if seeds else set()
    return [
        np.array([one.last(100) for one in cell.finished if one.run.seed in common])
        for cell in cells_
    ]


def _in_units(
    scores: list[Floats], bases: list[Floats], arm: str, *, is_base: bool
) -> dict[str, Any]:
    values, certain = [], True
    for place, (one, base) in enumerate(zip(scores, bases, strict=True)):
        label = f"over/{arm}/{place}"
        drawn = resampled(one, lambda values: values, label)
        unit = drawn.mean(axis=1) if is_base else resampled(base, mean, f"{label}/base")
        certain &= bool((unit > 0).all())
        values.append(drawn / unit[:, None])
    shares = [one / base.mean() for one, base in zip(scores, bases, strict=True)]
    drawn_together = interquartile_mean(np.concatenate(values, axis=1))
    return {
        "seeds": len(scores[0]),
        "mean": float(np.mean([one.mean() for one in shares])),
        "iqm": float(interquartile_mean(np.concatenate(shares))),
        "iqm_interval": interval(drawn_together) if certain and not is_base else None,
    }


def _unlike_the_paper(found: Sequence[Cell]) -> dict[str, Any]:
    """Settings of the first arm on an environment of the paper's that are not its recipe's."""
    cell = next((one for one in found if reported(one.env) is not None), None)
    if cell is None:
        return {}
    made = (one.facts["config"] for one in cell.finished if "config" in one.facts)
    settings = [
        f"{name} {ours} (paper {theirs})"
        for group, name, ours, theirs in PRESETS["paper"](cell.env).unequal(
            next(made, cell.runs[0].config.to_dict())
        )
        if group != "run" and name != "psi"
    ]
    return {"env": cell.env, "settings": settings}


def _run_otherwise(found: Sequence[Cell]) -> dict[str, list[str]]:
    """Runs whose settings are not what the commands of the report give, and in what."""
    differences: dict[str, list[str]] = {}
    for cell in found:
        first = cell.runs[0]
        for one in cell.finished:
            found_ = [
                f"--{name.replace('_', '-')} was {was}"
                for _, name, was, _ in one.run.config.unequal(one.facts.get("config", {}))
            ]
            if (one.run.settings, one.run.steps) != (first.settings, first.steps):
                found_.append(f"seed {first.seed} of its arm has other settings")
            if found_:
                differences[one.run.name] = found_
    return differences


def _versions(found: Sequence[Cell]) -> dict[str, Any]:
    """Of this report, and of the runs: more than one of a kind if they differ."""
    runs: dict[str, set[str]] = {}
    for one in (one for cell in found for one in cell.finished):
        for name, number in one.facts.get("versions", {}).items():
            runs.setdefault(name, set()).add(number)
        runs.setdefault("code", set()).add(one.facts.get("code", "not recorded"))
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
