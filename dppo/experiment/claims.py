"""The paper's claims, what came out here, and one sentence of judgement on each."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from dppo.experiment.claim_rows import Claim, Row, cost, judged, rows, times
from dppo.experiment.claims_discussed import discussed
from dppo.experiment.claims_over_all import in_all, outperforms, reduces
from dppo.experiment.numbers import ends
from dppo.experiment.significance import equal_spreads_of, welch_of
from dppo.experiment.verdicts import (
    Summary,
    of_falls,
    of_interval,
    of_mean,
    of_spread,
    of_spread_within,
)

_EARLY = 1.5
"""A run has to be so many times as long as the first mark for that to be early."""


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
        yield in_all(found)
        yield outperforms(found)
        yield reduces(found)
        yield from discussed(found)


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
        "Better than the paper reports: higher." if better else judged(verdict, rises),
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
        + times(found.get("std_ratio"), found.get("std_ratio_interval"))
        + ("" if p is None else f"; Brown-Forsythe p = {p:.2g}")
        + f"; of all their last episodes {pooled[0]:.1f} against {pooled[1]:.1f}",
        judged(of_spread(row.comparison), "lower", cost(row, of_mean(row.comparison))),
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
        f"{_typical(stds[1])}" + times(one.get("std_ratio"), one.get("std_ratio_interval")),
        judged(
            of_spread_within(one, seeds),
            "lower",
            cost(row, of_interval(one["mean"]["interval"], seeds)),
        ),
    )


def _of_life(row: Row) -> Iterator[Claim]:
    found = row.comparison.get("free", {})
    policies = [arm["evaluation"].get("free", {}) for arm in (row.safe, row.plain)]
    if not {"length", "terminated"} <= set(found):
        return  # nobody looked
    claim = f"{row.env}: risk-averse agents have a longer life-span"
    lengths = [one["length_mean"] for one in policies]
    falls = [one["falls"] for one in policies]
    if not any(falls):
        yield claim, f"no episode ends before {lengths[0]:.0f} steps", "Not judged: nobody falls."
        return
    yield (
        claim,
        f"episodes of {lengths[0]:.0f} steps against {lengths[1]:.0f}, difference "
        f"{found['length']['difference']:+.0f}{ends(found['length']['interval'], 0)}; falls "
        f"{falls[0]:.0%} against {falls[1]:.0%} of the episodes ({of_falls(found)})",
        judged(of_interval(found["length"]["interval"], min(found["seeds"])), "higher"),
    )


def _of_speed(row: Row) -> Iterator[Claim]:
    found = row.comparison["on_the_way"]
    if not found:
        return
    steps = min(found, key=int)
    if int(steps) * _EARLY > row.safe["steps"]:
        return  # that is the end, which the mean is judged by
    at = [arm["on_the_way"][steps]["mean"] for arm in (row.safe, row.plain)]
    seeds = min(row.comparison["last200"]["seeds"])
    yield (
        f"{row.env}: learning is faster, through that longevity",
        f"after {int(steps) / 1e6:g} million steps {at[0]:.1f} against {at[1]:.1f}, difference "
        f"{found[steps]['difference']:+.1f}{ends(found[steps]['interval'])}",
        judged(of_interval(found[steps]["interval"], seeds), "higher"),
    )


def _typical(stds: list[float]) -> str:
    """Geometric mean over seeds, which ratios are of; the plain one if a policy has no spread."""
    least = min(stds)
    return f"{np.exp(np.mean(np.log(stds))) if least > 0 else np.mean(stds):.1f}"


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
