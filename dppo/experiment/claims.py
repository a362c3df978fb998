"""The paper's claims, what came out here, and one sentence of judgement on each."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from dppo.experiment.numbers import ends
from dppo.experiment.paper import TABLE_2, Reported, reported
from dppo.experiment.significance import equal_spreads_of, welch_of
from dppo.experiment.verdicts import (
    Summary,
    of_interval,
    of_mean,
    of_ratio,
    of_spread,
    of_spread_within,
)

PSI_TOLERANCE = 1e-9
Claim = tuple[str, str, str]


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One row of Table 2, the paper's and ours."""

    env: str
    arm: str
    """Key of the safe arm."""
    paper: Reported
    plain: Summary
    safe: Summary

    @property
    def comparison(self) -> Summary:
        """The safe arm against the plain one."""
        found: Summary = self.safe["against_baseline"]
        return found


def rows(results: Mapping[str, Any]) -> Iterator[Row]:
    """Environments of which ψ = 0, the baseline, and the paper's ψ have finished runs.

    The arm with the paper's ψ has the baseline's other settings.
    """
    for env, one in results["environments"].items():
        paper, arms = reported(env), one["arms"]
        plain = arms.get(results["baseline"])
        if paper is None or plain is None or plain["psi"] != 0:
            continue
        for key, arm in arms.items():
            if (
                abs(arm["psi"] - paper.psi) < PSI_TOLERANCE
                and _without_psi(arm) == _without_psi(plain)
                and arm.get("against_baseline")
            ):
                yield Row(env=env, arm=key, paper=paper, plain=plain, safe=arm)
                break


def _without_psi(arm: Summary) -> dict[str, Any]:
    return {name: value for name, value in arm["settings"].items() if name != "psi"}


def claims(results: Mapping[str, Any]) -> Iterator[Claim]:
    """All of them that the finished runs say something about; of a partial grid, as interim."""
    interim = "Interim. " if results["status"] == "partial" else ""
    for paper, here, judgement in _claims(results):
        yield paper, here, interim + judgement


def _claims(results: Mapping[str, Any]) -> Iterator[Claim]:
    found = list(rows(results))
    for row in found:
        yield _of_mean(row)
        yield _of_spread(row)
        yield from _of_consistency(row)
        yield from _of_life(row)
        yield from _of_speed(row)
    if found:
        yield _in_all(found)
        yield _outperforms(found)
        yield _reduces(found, results["together"])


def _of_mean(row: Row) -> Claim:
    paper, verdict = row.paper, of_mean(row.comparison)
    rises = "higher" if paper.mean_rises else "lower"
    p, change = welch_of(paper.safe, paper.plain, paper.seeds), paper.safe[0] - paper.plain[0]
    better = verdict == "higher" and not paper.mean_rises
    return (
        f"{row.env}, figure {paper.figure}: {paper.claim_mean}. Mean {paper.safe[0]:g} against "
        f"{paper.plain[0]:g}: {rises}" + _from_its_numbers("Welch's test", p),
        f"mean {_mean(row.safe)} against {_mean(row.plain)}, difference {_difference(row)}"
        + _holds_theirs(_interval(row), change),
        "Better than the paper reports: higher." if better else _judged(verdict, rises),
    )


def _of_spread(row: Row) -> Claim:
    paper, found = row.paper, row.comparison["last200"]
    p = found["brown_forsythe_p"]
    theirs = equal_spreads_of(paper.safe[1], paper.plain[1], paper.seeds)
    pooled = [arm["training"]["last200"]["std_of_all_episodes"] for arm in (row.safe, row.plain)]
    return (
        f"{row.env}: {paper.claim_spread}; across seeds {paper.safe[1]:g} against "
        f"{paper.plain[1]:g}: lower" + _from_its_numbers("F test", theirs),
        f"spread across seeds {_std(row.safe)} against {_std(row.plain)}"
        + _times(found.get("std_ratio"), found.get("std_ratio_interval"))
        + ("" if p is None else f"; Brown-Forsythe p = {p:.2g}")
        + f"; of all their last episodes {pooled[0]:.1f} against {pooled[1]:.1f}",
        _judged(of_spread(row.comparison), "lower", _cost(row, of_mean(row.comparison))),
    )


def _of_consistency(row: Row) -> Iterator[Claim]:
    """Of one policy's episodes; the paper measures nothing of that."""
    found = row.comparison.get("free", {})
    if "undiscounted" not in found:
        return
    one, seeds = found["undiscounted"], min(found["seeds"])
    stds = [arm["evaluation"]["free"]["undiscounted"]["std_by_seed"]
            for arm in (row.safe, row.plain)]  # fmt: skip
    whose = "" if row.paper.env == "Walker2d" else " (the paper says it of Walker2d)"
    yield (
        f"{row.env}: the agent takes steps inducing consistent behaviour{whose}",
        f"returns of one policy's episodes spread by {_typical(stds[0])} against "
        f"{_typical(stds[1])}" + _times(one.get("std_ratio"), one.get("std_ratio_interval")),
        _judged(
            of_spread_within(one, seeds),
            "lower",
            _cost(row, of_interval(one["mean"]["interval"], seeds)),
        ),
    )


def _of_life(row: Row) -> Iterator[Claim]:
    found = row.comparison.get("free", {})
    policies = [arm["evaluation"].get("free", {}) for arm in (row.safe, row.plain)]
    if not {"length", "terminated"} <= set(found) or not any(one["falls"] for one in policies):
        return  # nobody falls here, or nobody looked
    lengths = [one["length_mean"] for one in policies]
    falls = [one["falls"] for one in policies]
    yield (
        f"{row.env}: risk-averse agents have a longer life-span",
        f"episodes of {lengths[0]:.0f} steps against {lengths[1]:.0f}, difference "
        f"{found['length']['difference']:+.0f}{ends(found['length']['interval'], 0)}; falls "
        f"{falls[0]:.0%} against {falls[1]:.0%}",
        _judged(of_interval(found["length"]["interval"], min(found["seeds"])), "higher"),
    )


def _of_speed(row: Row) -> Iterator[Claim]:
    found = row.comparison["on_the_way"]
    if not found:
        return
    steps = min(found, key=int)
    at = [arm["on_the_way"][steps]["mean"] for arm in (row.safe, row.plain)]
    seeds = min(row.comparison["last200"]["seeds"])
    yield (
        f"{row.env}: learning is faster, through that longevity",
        f"after {int(steps) / 1e6:g} million steps {at[0]:.1f} against {at[1]:.1f}, difference "
        f"{found[steps]['difference']:+.1f}{ends(found[steps]['interval'])}",
        _judged(of_interval(found[steps]["interval"], seeds), "higher"),
    )


def _in_all(found: list[Row]) -> Claim:
    """A spread that is bought with a lower mean is no boost."""
    shown = [
        row.env
        for row in found
        if (mean := of_mean(row.comparison)) == "higher"
        or (of_spread(row.comparison) == "lower" and mean != "lower")
    ]
    return (
        "Safety boosts performance in all 4 environments, in mean or in spread",
        f"shown in {len(shown)} of {len(found)} environments{_named(shown)}",
        _in_all_four(found, len(shown)),
    )


def _outperforms(found: list[Row]) -> Claim:
    higher, lower = (_where(found, of_mean, verdict) for verdict in ("higher", "lower"))
    verdict = "Does not hold here." if lower else _in_all_four(found, len(higher))
    return (
        "It outperforms DPPO in all the environments (key contributions); its own Table 2 has a "
        "lower mean on Walker2d",
        f"mean higher in {len(higher)} of {len(found)}{_named(higher)}, lower in "
        f"{len(lower)}{_named(lower)}",
        verdict,
    )


def _reduces(found: list[Row], together: Mapping[str, Any]) -> Claim:
    """Judged by all environments together: a single one shows little with few seeds."""
    higher, lower = (_where(found, of_spread, verdict) for verdict in ("higher", "lower"))
    arms = {row.arm for row in found}
    ratio = together.get(arms.pop(), {}).get("across") if len(arms) == 1 else None
    verdict = of_ratio(ratio)
    if len({row.paper.env for row in found}) < len(TABLE_2):
        judgement = _in_all_four(found, 0)
    elif higher:
        judgement = f"The claim does not hold here: higher{_named(higher)}."
    else:
        judgement = _judged(verdict, "lower")
    return (
        "A significant reduction in the standard deviation of the scores in all the environments "
        "(abstract); from its own numbers it is significant in none",
        f"spread across seeds lower in {len(lower)} of {len(found)}{_named(lower)}, higher in "
        f"{len(higher)}{_named(higher)}; all environments together"
        + (_times(ratio["ratio"], ratio["interval"]) if ratio else ": no ratio"),
        judgement,
    )


def _where(found: list[Row], judge: Callable[[Summary], str], verdict: str) -> list[str]:
    """Environments with this verdict."""
    return [row.env for row in found if judge(row.comparison) == verdict]


def _in_all_four(found: list[Row], shown: int) -> str:
    """Whether what is claimed of all environments is shown in all of them."""
    there = len({row.paper.env for row in found})
    if there < len(TABLE_2):
        return f"Not decided: {there} of the {len(TABLE_2)} environments were run."
    return "Holds here." if shown == len(found) else "Not shown here in all of them."


def _judged(verdict: str, claimed: str, cost: str = "") -> str:
    """`cost`: what a verdict that is as claimed was bought with."""
    if verdict == claimed:
        return (
            f"Not what is claimed: {verdict}, but {cost}."
            if cost
            else (f"The claim holds here: {verdict}.")
        )
    if verdict in ("higher", "lower"):
        return f"The claim does not hold here: {verdict}."
    return f"Not decided: {verdict}."


def _cost(row: Row, mean: str) -> str:
    """The paper lowers the spread at no cost in mean, but on Walker2d."""
    return "at a lower mean" if mean == "lower" and row.paper.mean_rises else ""


def _typical(stds: list[float]) -> str:
    """Geometric mean over seeds, which ratios are of; the plain one if a policy has no spread."""
    least = min(stds)
    return f"{np.exp(np.mean(np.log(stds))) if least > 0 else np.mean(stds):.1f}"


def _named(envs: list[str]) -> str:
    return f" ({', '.join(envs)})" if envs else ""


def _mean(arm: Summary) -> str:
    return f"{arm['training']['last200']['mean']:.1f}"


def _std(arm: Summary) -> str:
    std = arm["training"]["last200"]["std_across_seeds"]
    return "of one (no spread)" if std is None else f"{std:.1f}"


def _interval(row: Row) -> Any:  # noqa: ANN401  JSON
    return row.comparison["last200"]["welch_interval"]


def _difference(row: Row) -> str:
    return f"{row.comparison['last200']['difference']:+.1f}{ends(_interval(row))}"


def _holds_theirs(interval: Any, change: float) -> str:  # noqa: ANN401  JSON
    if interval is None:
        return ""
    inside = interval[0] <= change <= interval[1]
    return f"; the paper's {change:+.1f} lies {'within' if inside else 'outside'}"


def _from_its_numbers(test: str, p: float | None) -> str:
    return "" if p is None else f" ({test} from these numbers: p = {p:.2g})"


def _times(value: float | None, interval: Any) -> str:  # noqa: ANN401  JSON
    return "" if value is None else f", {value:.2f} times{ends(interval, 2)}"
