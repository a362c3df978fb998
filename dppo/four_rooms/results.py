"""`results.json`: every number of the experiment, and what it was run with."""

import platform
from collections.abc import Sequence
from dataclasses import asdict
from importlib.metadata import version
from typing import Any

import numpy as np

from dppo.four_rooms.experiment import ArmOutcome
from dppo.four_rooms.mdp import Floats
from dppo.four_rooms.optimum import Optimum, best
from dppo.four_rooms.oracle import evaluate
from dppo.four_rooms.rollouts import Visits, visits
from dppo.four_rooms.summary import LAST, Bootstrap, compare, summarise
from dppo.four_rooms.world import World

Results = dict[str, Any]
MAIN = ("plain", "safe")
"""The arms of Table 1."""


def describe(
    world: World, outcomes: Sequence[ArmOutcome], *, seed: int, tests: dict[str, Visits]
) -> Results:
    """The figures of all arms; the comparison of Table 1's arms if both are there."""
    mdp = world.mdp
    trials, episodes = outcomes[0].returns.shape
    bootstrap = Bootstrap(trials, seed)
    arms = [summarise(outcome, mdp, bootstrap) for outcome in outcomes]
    for arm in arms:
        if arm["key"] in tests:
            arm["test"] = _of_tests(world, tests[arm["key"]])
    by_key = {outcome.arm.key: outcome for outcome in outcomes}
    results: Results = {"arms": arms}
    if all(key in by_key for key in MAIN):
        results["comparison"] = compare(by_key["plain"], by_key["safe"], bootstrap)
    results["optimum"] = [
        _of_optimum(world, outcome, optimum_for(world, outcome))
        for key, outcome in by_key.items()
        if key in MAIN
    ]
    results["config"] = {
        "trials": trials,
        "episodes": episodes,
        "seed": seed,
        "last_episodes": min(LAST, episodes),
        "world": asdict(world.config),
        "agents": {key: asdict(outcome.arm.agent) for key, outcome in by_key.items()},
    }
    results["versions"] = {
        "python": platform.python_version(),
        **{name: version(name) for name in ("dppo", "numpy", "matplotlib")},
    }
    return results


def test_runs(world: World, outcomes: Sequence[ArmOutcome], seed: int) -> dict[str, Visits]:
    """80 test episodes of every final policy of Table 1's arms."""
    return {
        outcome.arm.key: visits(world, list(outcome.policies), seed=seed)
        for outcome in outcomes
        if outcome.arm.key in MAIN
    }


def optimum_for(world: World, outcome: ArmOutcome) -> Optimum:
    """The best policy under the objective of an arm."""
    agent = outcome.arm.agent
    return best(world.mdp, psi=agent.psi, gamma=agent.gamma, lambda_ret=agent.lambda_ret)


def typical(outcome: ArmOutcome) -> int:
    """The trial whose mean return of the last episodes is the median of its arm."""
    means = outcome.returns[:, -LAST:].mean(axis=1)
    return int(np.argsort(means, kind="stable")[len(means) // 2])


def onto_ice(world: World, policies: Floats) -> float:
    """Mean over policies [N, S, A]: cells off the ice whose likeliest action leads onto it."""
    likeliest = policies.argmax(axis=2)
    there = world.ways[np.arange(world.states), likeliest]
    enters = world.frozen[there] & ~world.frozen
    enters[:, world.goal] = False
    return float(enters.sum(axis=1).mean())


def _of_tests(world: World, found: Visits) -> Results:
    return {
        "frozen_time_share": float(found.share[world.frozen].sum()),
        "episodes_touching_ice": found.touching,
    }


def _of_optimum(world: World, outcome: ArmOutcome, optimum: Optimum) -> Results:
    agent, mdp = outcome.arm.agent, world.mdp
    exact = evaluate(mdp, optimum.policy, agent.gamma, agent.lambda_ret)
    return {
        "key": outcome.arm.key,
        "psi": agent.psi,
        "objective": optimum.objective,
        "exact_value_mean": float(mdp.start @ exact.v),
        "exact_sigma_mean": float(mdp.start @ exact.sigma),
        "cells_onto_ice": onto_ice(world, optimum.policy[None]),
        "learned_cells_onto_ice": onto_ice(world, outcome.policies),
    }
