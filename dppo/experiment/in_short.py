"""The report's first table: of each arm and measure, where it differs from the baseline."""

from collections.abc import Iterator, Mapping
from typing import Any

from dppo.experiment.numbers import NOTHING, ends
from dppo.experiment.page import Table
from dppo.experiment.results import Results
from dppo.experiment.tables import arms_of
from dppo.experiment.verdicts import of_goal, of_interval, of_mean, of_spread, of_spread_within

Comparisons = Mapping[str, Mapping[str, Any]]


def in_short(results: Results) -> Table | None:
    """Of arms that have two seeds somewhere, as has the baseline; None: of no arm."""
    lines = []
    for key in dict.fromkeys(key for _, key, _ in arms_of(results)):
        compared = {
            env: found
            for env, arm, one in arms_of(results)
            if arm == key
            and (found := one.get("against_baseline"))
            and min(found["last200"]["seeds"]) > 1
        }
        together = results["together"].get(key, {})
        for measure, verdicts, over in _measures(compared):
            lines.append((key, measure, _grouped(verdicts), _ratio(together.get(over))))
    head = ("arm", "measure", "against the baseline", "all environments together")
    return Table(head, lines) if lines else None


def _measures(compared: Comparisons) -> Iterator[tuple[str, dict[str, str], str]]:
    """Name, verdict on each environment, and the name of the measure over all of them."""
    if not compared:
        return
    yield "mean return in training", {env: of_mean(one) for env, one in compared.items()}, ""
    spreads = {env: of_spread(one) for env, one in compared.items()}
    yield "its spread across seeds", spreads, "across"
    policies = {
        env: one["free"]
        for env, one in compared.items()
        if "undiscounted" in one.get("free", {}) and min(one["free"]["seeds"]) > 1
    }
    if policies:
        yield from _of_policies(policies)


def _of_policies(policies: Comparisons) -> Iterator[tuple[str, dict[str, str], str]]:
    seeds = {env: min(one["seeds"]) for env, one in policies.items()}
    returns = {env: one["undiscounted"] for env, one in policies.items()}
    means = {env: of_interval(one["mean"]["interval"], seeds[env]) for env, one in returns.items()}
    yield "mean return of final policies", means, "within_mean"
    within = {env: of_spread_within(one, seeds[env]) for env, one in returns.items()}
    yield "spread within a final policy", within, "within"
    goals = {env: of_goal({"free": one}, "free", "undiscounted") for env, one in policies.items()}
    yield "30 % less of that for 5 % of the mean", goals, ""
    falls = {
        env: of_interval(one["terminated"]["interval"], seeds[env])
        for env, one in policies.items()
        if "interval" in one.get("terminated", {})
    }
    if falls:
        yield "falls", falls, ""


def _grouped(verdicts: Mapping[str, str]) -> str:
    """Each verdict with the environments it is given on."""
    envs: dict[str, list[str]] = {}
    for env, verdict in verdicts.items():
        envs.setdefault(verdict, []).append(env)
    return "; ".join(f"{verdict} ({', '.join(where)})" for verdict, where in envs.items())


def _ratio(one: Any) -> str:  # noqa: ANN401  JSON
    return NOTHING if one is None else f"{one['ratio']:.2f} times{ends(one['interval'], 2)}"
