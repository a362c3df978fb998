"""`results.json`: every number of the experiment, and what it was run with."""

import platform
from collections.abc import Sequence
from dataclasses import asdict, dataclass
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Findings:
    """What was run, and what was measured of it afterwards; by key of the arm."""

    world: World
    seed: int
    outcomes: dict[str, ArmOutcome]
    tests: dict[str, Visits]  # of Table 1's arms
    optima: dict[str, Optimum]  # under the objective of Table 1's arms

    @property
    def main(self) -> list[ArmOutcome]:
        """The arms of Table 1 that have finished."""
        return [self.outcomes[key] for key in MAIN if key in self.outcomes]


def measure(world: World, outcomes: Sequence[ArmOutcome], *, seed: int) -> Findings:
    """Test episodes of the final policies of Table 1's arms, and the best policies."""
    main = [outcome for outcome in outcomes if outcome.arm.key in MAIN]
    tests, optima = {}, {}
    for outcome in main:
        key, agent = outcome.arm.key, outcome.arm.agent
        tests[key] = visits(world, list(outcome.policies), seed=seed)
        optima[key] = best(
            world.mdp, psi=agent.psi, gamma=agent.gamma, lambda_ret=agent.lambda_ret
        )
    by_key = {outcome.arm.key: outcome for outcome in outcomes}
    return Findings(world=world, seed=seed, outcomes=by_key, tests=tests, optima=optima)


def describe(findings: Findings) -> Results:
    """The figures of all arms; the comparison of Table 1's arms if both are there."""
    world, outcomes = findings.world, findings.outcomes
    trials, episodes = next(iter(outcomes.values())).returns.shape
    bootstrap = Bootstrap(trials, findings.seed)
    results: Results = {
        "arms": [summarise(outcome, world.mdp, bootstrap) for outcome in outcomes.values()]
    }
    for arm in results["arms"]:
        if arm["key"] in findings.tests:
            arm["test"] = _of_tests(world, findings.tests[arm["key"]])
    if len(findings.main) == len(MAIN):
        plain, safe = findings.main
        results["comparison"] = compare(plain, safe, bootstrap)
    results["optimum"] = [_of_optimum(findings, outcome) for outcome in findings.main]
    results["config"] = {
        "trials": trials,
        "episodes": episodes,
        "seed": findings.seed,
        "last_episodes": min(LAST, episodes),
        "world": asdict(world.config),
        "agents": {key: asdict(outcome.arm.agent) for key, outcome in outcomes.items()},
    }
    results["versions"] = {
        "python": platform.python_version(),
        **{name: version(name) for name in ("dppo", "numpy", "matplotlib")},
    }
    return results


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


def _of_optimum(findings: Findings, outcome: ArmOutcome) -> Results:
    world, agent = findings.world, outcome.arm.agent
    policy = findings.optima[outcome.arm.key].policy
    exact = evaluate(world.mdp, policy, agent.gamma, agent.lambda_ret)
    tested = visits(world, [policy] * len(outcome.policies), seed=findings.seed)
    return {
        "key": outcome.arm.key,
        "psi": agent.psi,
        "objective": findings.optima[outcome.arm.key].objective,
        "exact_value_mean": float(world.mdp.start @ exact.v),
        "exact_sigma_mean": float(world.mdp.start @ exact.sigma),
        "cells_onto_ice": onto_ice(world, policy[None]),
        "learned_cells_onto_ice": onto_ice(world, outcome.policies),
        "test": _of_tests(world, tested),
    }
