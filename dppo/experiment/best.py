"""The best seed of each arm: whose policy to look at, and what it does."""

from typing import Any

import numpy as np

from dppo.experiment.measure import STARTS, Cell, Finished
from dppo.statistics import spread


def best_of(cell: Cell) -> Finished | None:
    """The seed whose last 100 training episodes return most; None: no seed has finished."""
    return max(cell.finished, key=lambda one: one.last(100), default=None)


def best_seed(cell: Cell) -> dict[str, Any] | None:
    """It, as results.json has it, with what `dppo eval` prints of its policy."""
    best = best_of(cell)
    if best is None:
        return None
    found: dict[str, Any] = {
        "seed": best.run.seed,
        "run": f"runs/{best.run.name}",
        "checkpoint": best.evaluation.get("settings", {}).get("checkpoint"),
        "last100": best.last(100),
    }
    for start in STARTS:
        returns = np.array([float(one["return"]) for one in best.episodes(start)])
        if len(returns):
            found[start] = {"mean": float(returns.mean()), "std": float(spread(returns))}
    return found
