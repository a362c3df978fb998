"""Sentences of judgement, computed from intervals and tests; the paper's claims beside them."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from dppo.experiment.paper import TABLE_2, Reported, reported

SIGNIFICANT = 0.05
PSI_TOLERANCE = 1e-9
GOAL_SPREAD, GOAL_MEAN = 0.7, 0.95
"""What a safe policy's user would want: times the baseline's spread at most, mean at least."""
Summary = Mapping[str, Any]


def of_interval(interval: Any, seeds: int, *, zero: float = 0.0) -> str:  # noqa: ANN401  JSON
    """`higher` or `lower` if the interval leaves out "no difference"."""
    if seeds < 2:
        return "one seed shows nothing"
    if interval is None:
        return "not judged: no interval"
    low, high = interval
    if low > zero:
        return "higher"
    if high < zero:
        return "lower"
    return f"no difference that {seeds} seeds can show"


def of_mean(comparison: Summary) -> str:
    """Mean return against the baseline's: Welch's interval, or resampling without SciPy."""
    found = comparison["last200"]
    interval = found["welch_interval"] or found.get("difference_interval")
    return of_interval(interval, min(found["seeds"]))


def of_spread(comparison: Summary) -> str:
    """Spread across seeds against the baseline: the Brown-Forsythe test."""
    found = comparison["last200"]
    seeds, p = min(found["seeds"]), found["brown_forsythe_p"]
    if seeds < 2:
        return "one seed shows nothing"
    if p is None:
        return "not judged: too few seeds, or SciPy is missing"
    if p >= SIGNIFICANT:
        return f"no difference that {seeds} seeds can show"
    return "lower" if (found.get("std_ratio") or 0.0) < 1 else "higher"


def of_policies(comparison: Summary, start: str) -> str:
    """Spread of returns within a policy, and what it costs in mean, against the baseline."""
    found = comparison[start]
    seeds = min(comparison["last200"]["seeds"])
    spread = of_interval(found.get("std_ratio_interval"), seeds, zero=1.0)
    if "std_ratio" not in found or found["std_ratio"] is None:
        spread = of_interval(found["std_difference_interval"], seeds)
    mean = of_interval(found["mean_difference_interval"], seeds)
    return f"spread {spread}; mean {mean}"


def of_goal(comparison: Summary, start: str) -> str:
    """Is the spread within a policy 30 % lower, for at most 5 % of the mean?"""
    found = comparison[start]
    ratios = [found.get(f"{name}_ratio") for name in ("std", "mean")]
    if None in ratios:
        return "not judged: the baseline's mean or spread is not above 0"
    (_, most), (least, _) = (found[f"{name}_ratio_interval"] for name in ("std", "mean"))
    if most <= GOAL_SPREAD and least >= GOAL_MEAN:
        return "yes"
    reached = ratios[0] <= GOAL_SPREAD and ratios[1] >= GOAL_MEAN
    return "the estimate only, not the intervals" if reached else "no"


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One row of Table 2, the paper's and ours."""

    env: str
    paper: Reported
    plain: Summary
    safe: Summary

    @property
    def comparison(self) -> Summary:
        """The safe arm against the plain one."""
        found: Summary = self.safe["against_baseline"]
        return found


def rows(results: Mapping[str, Any]) -> Iterator[Row]:
    """Environments of which the paper's ψ and ψ = 0, the baseline, have finished runs."""
    for env, one in results["environments"].items():
        paper, arms = reported(env), one["arms"]
        if paper is None:
            continue
        plain = arms.get(results["baseline"])
        safe = next(
            (
                arm
                for arm in arms.values()
                if abs(arm["psi"] - paper.psi) < PSI_TOLERANCE and arm.get("against_baseline")
            ),
            None,
        )
        if plain is not None and plain["psi"] == 0 and safe is not None:
            yield Row(env=env, paper=paper, plain=plain, safe=safe)


def claims(results: Mapping[str, Any]) -> Iterator[tuple[str, str, str]]:
    """What the paper says, what came out here, and one sentence of judgement."""
    found = list(rows(results))
    for row in found:
        yield _of_mean(row)
        yield _of_spread(row)
    if found:
        yield _in_all(found)
        yield _outperforms(found)


def _of_mean(row: Row) -> tuple[str, str, str]:
    paper, verdict = row.paper, of_mean(row.comparison)
    rises = "higher" if paper.mean_rises else "lower"
    return (
        f"{row.env}, figure {paper.figure}: {paper.claim_mean}. Mean {paper.safe[0]:g} against "
        f"{paper.plain[0]:g}: {rises}",
        f"mean {_mean(row.safe)} against {_mean(row.plain)}, difference {_difference(row)}",
        _judged(verdict, rises),
    )


def _of_spread(row: Row) -> tuple[str, str, str]:
    paper, verdict = row.paper, of_spread(row.comparison)
    p = row.comparison["last200"]["brown_forsythe_p"]
    return (
        f"{row.env}: spread across seeds {paper.safe[1]:g} against {paper.plain[1]:g}: lower",
        f"spread {_std(row.safe)} against {_std(row.plain)}"
        + ("" if p is None else f", Brown-Forsythe p = {p:.2g}"),
        _judged(verdict, "lower"),
    )


def _in_all(found: list[Row]) -> tuple[str, str, str]:
    shown = [
        row.env
        for row in found
        if of_mean(row.comparison) == "higher" or of_spread(row.comparison) == "lower"
    ]
    return (
        "Safety boosts performance in all 4 environments, in mean or in spread",
        f"shown in {len(shown)} of {len(found)} environments{_named(shown)}",
        _in_all_four(found, len(shown)),
    )


def _outperforms(found: list[Row]) -> tuple[str, str, str]:
    higher = [row.env for row in found if of_mean(row.comparison) == "higher"]
    lower = [row.env for row in found if of_mean(row.comparison) == "lower"]
    verdict = "Does not hold here." if lower else _in_all_four(found, len(higher))
    return (
        "It outperforms DPPO in all the environments (key contributions); its own Table 2 has a "
        "lower mean on Walker2d",
        f"mean higher in {len(higher)} of {len(found)}{_named(higher)}, lower in "
        f"{len(lower)}{_named(lower)}",
        verdict,
    )


def _in_all_four(found: list[Row], shown: int) -> str:
    """Whether what is claimed of all environments is shown in all of them."""
    there = len({row.paper.env for row in found})
    if there < len(TABLE_2):
        return f"Not decided: {there} of the {len(TABLE_2)} environments were run."
    return "Holds here." if shown == len(found) else "Not shown here in all of them."


def _judged(verdict: str, claimed: str) -> str:
    if verdict == claimed:
        return f"The claim holds here: {verdict}."
    if verdict in ("higher", "lower"):
        return f"The claim does not hold here: {verdict}."
    return f"Not decided: {verdict}."


def _named(envs: list[str]) -> str:
    return f" ({', '.join(envs)})" if envs else ""


def _mean(arm: Summary) -> str:
    return f"{arm['training']['last200']['mean']:.1f}"


def _std(arm: Summary) -> str:
    std = arm["training"]["last200"]["std_across_seeds"]
    return "of one seed" if std is None else f"{std:.1f}"


def _difference(row: Row) -> str:
    found = row.comparison["last200"]
    interval = found["welch_interval"] or found.get("difference_interval")
    ends = "" if interval is None else f" [{interval[0]:.1f}, {interval[1]:.1f}]"
    return f"{found['difference']:+.1f}{ends}"
