"""The report's tables of final policies: evaluation episodes, and σ against them."""

from collections.abc import Iterator
from typing import Any

from dppo.experiment.calibrated import GOAL, OPEN, OUTSIDE, WITHIN
from dppo.experiment.numbers import NOTHING, ends, over_seeds, seed_range, times, with_ends
from dppo.experiment.page import Table
from dppo.experiment.results import Results
from dppo.experiment.tables import arms_of
from dppo.experiment.verdicts import of_goal, of_policies


def within_policies(results: Results, start: str, kind: str) -> Table | None:
    """Returns of evaluation episodes, without columns that hold nothing; None: there are none."""
    found = [
        (env, key, arm)
        for env, key, arm in arms_of(results)
        if kind in arm["evaluation"].get(start, {})
    ]
    columns: dict[str, list[str]] = {"environment": [], "arm": [], "seeds x episodes": []}
    for env, key, arm in found:
        one = arm["evaluation"][start]
        columns["environment"].append(env)
        columns["arm"].append(arm["label"])
        columns["seeds x episodes"].append(f"{one['seeds']} x {one['episodes_per_seed']}")
        for name, text in _of_policy(arm, start, kind, is_base=key == results["baseline"]):
            columns.setdefault(name, []).append(text)
    columns = {
        name: texts for name, texts in columns.items() if any(text != NOTHING for text in texts)
    }
    return Table(list(columns), list(zip(*columns.values(), strict=True))) if found else None


def _of_policy(arm: Results, start: str, kind: str, *, is_base: bool) -> Iterator[tuple[str, str]]:
    one = arm["evaluation"][start]
    against = (arm.get("against_baseline") or {}).get(start, {})
    returns = against.get(kind, {})
    yield "mean", with_ends(one[kind], "mean")
    yield "std", with_ends(one[kind], "std")
    yield "std / baseline's", times(returns, "std")
    yield "mean / baseline's", times(returns, "mean")
    yield "CVaR 10 %", with_ends(one[kind], "cvar10")
    yield "CVaR, difference", _change(returns.get("cvar10"), 1)
    yield "worst", f"{one[kind]['worst']:.1f}"
    if kind == "undiscounted":
        yield "falls", _share(one)
        yield "falls, difference", _change(against.get("terminated"), 3)
        yield "steps", f"{one['length_mean']:.0f}" if "length_mean" in one else NOTHING
    verdict = of_policies(arm["against_baseline"], start, kind) if returns else NOTHING
    yield "against the baseline", "baseline" if is_base else verdict
    goal = of_goal(arm["against_baseline"], start, kind) if returns else NOTHING
    yield "30 % less spread for 5 % of the mean", goal


_PLACES = {
    "along": "along the way", "along_squares": "against TD errors", "start": "at the start"
}  # fmt: skip


def calibrations(results: Results) -> Table | None:
    """Predicted over empirical standard deviation of the λ-return; None: nothing."""
    lines = [
        (
            env,
            arm["label"],
            f"{one['lambda_ret']:g}" if one["lambda_ret"] is not None else NOTHING,
            f"{one['seeds']}",
            _ratio(one.get("along")),
            _ratio(one.get("along_squares")),
            _range(one.get("worst_tenth")),
            _ratio(one.get("start")),
            *[
                f"{one[name]['mean']:.3g}" if name in one else NOTHING
                for name in ("predicted_std", "squares_std", "empirical_std")
            ],
        )
        for env, _, arm in arms_of(results)
        if (one := arm["calibration"])
    ]
    head = (
        "environment", "arm", "λ_ret", "seeds", "along the way: predicted / empirical",
        "predicted / from TD errors", "worst tenth", "at the start: predicted / empirical",
        "predicted at the start", "from its TD errors", "empirical",
    )  # fmt: skip
    return Table(head, lines) if lines else None


def best_seeds(results: Results) -> Table | None:
    """The best seed of each arm, with figures as `dppo eval` prints them; None: there are none."""
    lines = [
        (env, arm["label"], f"`{one['run']}`", f"{one['last100']:.1f}", _return(one, "free"),
         _return(one, "fixed"))
        for env, _, arm in arms_of(results)
        if (one := arm["best_seed"]) and "free" in one
    ]  # fmt: skip
    head = ("environment", "arm", "run", "last 100", "free starts", "the same start")
    return Table(head, lines) if lines else None


def calibration_sentence(results: Results) -> str:
    """Of how many policies σ is right within a quarter: by estimates, and by intervals."""
    found = [one for _, _, arm in arms_of(results) if (one := arm["calibration"])]
    parts = []
    for name, words in _PLACES.items():
        ratios = [ratio for one in found for ratio in one.get(name, {}).get("by_seed", [])]
        if ratios:
            within = sum(1 / GOAL <= ratio <= GOAL for ratio in ratios)
            parts.append(f"{words} of {within} of {len(ratios)} policies")
            verdicts = [v for one in found for v in one.get(name, {}).get("verdicts", [])]
            if verdicts:
                counts = ", ".join(
                    f"{verdict} for {verdicts.count(verdict)}"
                    for verdict in (WITHIN, OUTSIDE, OPEN)
                )
                parts[-1] += f" (by its 95 % interval {counts})"
    return f"Within 25 %: {'; '.join(parts)}."


def _ratio(one: Any) -> str:  # noqa: ANN401  JSON
    """Geometric mean, and from which to which seed."""
    if one is None:
        return NOTHING
    return over_seeds(one["geometric_mean"], one["by_seed"], ".2f")


def _range(one: Any) -> str:  # noqa: ANN401  JSON
    return NOTHING if one is None else seed_range(one["by_seed"], ".2f")


def _return(one: Results, start: str) -> str:
    return f"{one[start]['mean']:.6g} ± {one[start]['std']:.6g}" if start in one else NOTHING


def _share(one: Results) -> str:
    if "falls" not in one:
        return NOTHING
    interval = one["falls_interval"]
    return f"{one['falls']:.1%}" + (
        "" if interval is None else f" [{interval[0]:.1%}, {interval[1]:.1%}]"
    )


def _change(one: Any, digits: int) -> str:  # noqa: ANN401  JSON
    if one is None:
        return NOTHING
    return f"{one['difference']:+.{digits}f}{ends(one['interval'], digits)}"
