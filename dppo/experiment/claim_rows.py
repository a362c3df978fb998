"""Rows of Table 2, the paper's and ours, and how a claim about them is judged."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from dppo.experiment.numbers import both_ends, ends
from dppo.experiment.paper import Reported, reported
from dppo.experiment.verdicts import Summary

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
        if paper is None or plain is None or not plain["is_plain"]:
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


def judged(verdict: str, claimed: str, cost: str = "") -> str:
    """`cost`: what a verdict that is as claimed was bought with."""
    if verdict == claimed and cost:
        return f"Not what is claimed: {verdict}, but {cost}."
    if verdict == claimed:
        return f"The claim holds here: {verdict}."
    if verdict in ("higher", "lower"):
        return f"The claim does not hold here: {verdict}."
    if verdict.startswith("not judged"):
        return f"{verdict[0].upper()}{verdict[1:]}."
    return f"Not decided: {verdict}."


def cost(row: Row, mean: str) -> str:
    """What a lower spread was bought with: the paper's ψ lowers the mean on Walker2d alone.

    `mean`: the verdict on it. There a drop may be as large as the paper's.
    """
    if mean != "lower":
        return ""
    ours, theirs = (arm["training"]["last200"]["mean"] for arm in (row.safe, row.plain))
    drop = row.paper.safe[0] / row.paper.plain[0]
    if not row.paper.mean_rises and theirs > 0 and ours / theirs >= drop:
        return ""
    return "at a lower mean" + ("" if row.paper.mean_rises else f" than the paper's {drop:.0%}")


def named(envs: list[str]) -> str:
    """Environments in brackets; empty: none."""
    return f" ({', '.join(envs)})" if envs else ""


def times(value: float | None, interval: Any) -> str:  # noqa: ANN401  JSON
    """A ratio and its interval, behind a comma; empty: there is none."""
    return "" if value is None else f", {value:.2f} times{ends(interval, 2)}"


def times_together(one: Summary) -> str:
    """A ratio over environments and its intervals, behind a comma."""
    return f", {one['ratio']:.2f} times{both_ends(one)}"
