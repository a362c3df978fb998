"""The report's first table: of each arm and measure, where it differs from the baseline."""

from collections.abc import Iterator, Mapping
from typing import Any

from dppo.experiment.numbers import ratio_of
from dppo.experiment.page import Table
from dppo.experiment.results import Results
from dppo.experiment.tables import arms_of
from dppo.experiment.together import WITHIN_POLICIES
from dppo.experiment.verdicts import (
    of_falls,
    of_goal,
    of_interval,
    of_mean,
    of_spread,
    of_spread_within,
)

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
            lines.append((key, measure, _grouped(verdicts), ratio_of(together.get(over))))
    head = (
        "arm",
        "measure",
        "against the baseline",
        "over the baseline, all environments together",
    )
    return Table(head, lines) if lines else None


def _measures(compared: Comparisons) -> Iterator[tuple[str, dict[str, str], str]]:
    """Name, verdict on each environment, and the name of the measure over all of them."""
    if not compared:
        return
    yield "mean return in training", {env: of_mean(one) for env, one in compared.items()}, ""
    spreads = {env: of_spread(one) for env, one in compared.items()}
    yield "its spread across seeds", spreads, "across"
    for kind, within in WITHIN_POLICIES.items():
        yield from _of_policies(compared, kind, within)
    falls = {
        env: of_falls(free)
        for env, one in compared.items()
        if (free := one.get("free", {})).get("terminated") and _differ(free["terminated"])
    }
    if falls:
        yield "falls of final policies", falls, ""


def _differ(falls: Mapping[str, Any]) -> bool:
    """Somewhere somebody falls, that is: else there is nothing to judge."""
    return falls["interval"] is not None or falls["difference"] != 0


def _of_policies(
    compared: Comparisons, kind: str, name: str
) -> Iterator[tuple[str, dict[str, str], str]]:
    """Returns of final policies from free starts."""
    policies = {env: one for env, one in compared.items() if is_judged(one, kind)}
    if not policies:
        return
    free = {env: (one["free"][kind], min(one["free"]["seeds"])) for env, one in policies.items()}
    means = {
        env: of_interval(one["mean"]["interval"], seeds) for env, (one, seeds) in free.items()
    }
    yield f"mean of final policies, {kind}", means, f"{name}_mean"
    within = {env: of_spread_within(*one) for env, one in free.items()}
    yield f"std within a policy, {kind}", within, name
    goals = {env: of_goal(one, "free", kind) for env, one in policies.items()}
    yield f"30 % less std for 5 % of the mean, {kind}", goals, ""


def goal_sentence(results: Results) -> str:
    """On how many environments some arm reaches the goal of a safe policy; empty: no judgement."""
    parts = [part for kind in ("undiscounted", "discounted") if (part := _reached(results, kind))]
    if not parts:
        return ""
    return f"30 % less spread within a policy for at most 5 % of the mean: {'; '.join(parts)}."


def _reached(results: Results, kind: str) -> str:
    verdicts: dict[str, list[str]] = {}
    for env, _, arm in arms_of(results):
        if (found := arm.get("against_baseline")) and is_judged(found, kind):
            verdicts.setdefault(env, []).append(of_goal(found, "free", kind))
    if not verdicts:
        return ""
    envs = [env for env, found in verdicts.items() if "yes" in found]
    arms = max(map(len, verdicts.values()))
    names = f" ({', '.join(envs)})" if envs else ""
    best = f", by the best of {arms} arms" if arms > 1 else ""
    return f"of {kind} returns on {len(envs)} of {len(verdicts)} environments{names}{best}"


def is_judged(comparison: Mapping[str, Any], kind: str) -> bool:
    """There are policies of two seeds on either side."""
    free = comparison.get("free", {})
    return kind in free and min(free["seeds"]) > 1


def _grouped(verdicts: Mapping[str, str]) -> str:
    """Each verdict with the environments it is given on."""
    envs: dict[str, list[str]] = {}
    for env, verdict in verdicts.items():
        envs.setdefault(verdict, []).append(env)
    return "; ".join(f"{verdict} ({', '.join(where)})" for verdict, where in envs.items())
