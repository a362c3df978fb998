"""The report's tables."""

from collections.abc import Iterator, Mapping
from typing import Any

from dppo.experiment.page import Table
from dppo.experiment.results import Results
from dppo.experiment.verdicts import claims, of_goal, of_mean, of_policies, of_spread, rows

_NOTHING = "–"


def beside_the_paper(results: Results) -> Table | None:
    """Table 2, theirs and ours; None: no environment of the paper's has its arms."""
    lines = [
        (
            row.env,
            f"{row.paper.psi:g}",
            _pair(*row.paper.plain),
            _score(row.plain, 200),
            _pair(*row.paper.safe),
            _score(row.safe, 200),
            f"{row.paper.seeds}",
            f"{len(row.plain['seeds'])} / {len(row.safe['seeds'])}",
            f"mean: {of_mean(row.comparison)}; spread: {of_spread(row.comparison)}",
        )
        for row in rows(results)
    ]
    head = (
        "environment", "ψ", "paper: DPPO", "here: ψ 0", "paper: safe-DPPO", "here: the paper's ψ",
        "seeds, paper", "seeds, here", "here, with ψ",
    )  # fmt: skip
    return Table(head, lines) if lines else None


def claims_table(results: Results) -> Table:
    """The paper's claims, what came out, and one sentence of judgement."""
    return Table(("the paper", "here", "judgement"), list(claims(results)))


def all_arms(results: Results) -> Table:
    """Training returns of every arm, the unfinished ones as well."""
    head = (
        "environment", "arm", "seeds", "last 200", "last 100", "IQM, last 200",
        "difference to the baseline", "p", "P(better)", "p, spread", "mean", "spread",
    )  # fmt: skip
    return Table(head, list(_training_rows(results)))


def _training_rows(results: Results) -> Iterator[tuple[str, ...]]:
    for env, key, arm in _arms(results):
        count = f"{len(arm['seeds'])} of {len(arm['seeds_planned'])}"
        if not arm["training"]:
            yield (env, arm["label"], count, *[_NOTHING] * 9)
            continue
        last = arm["training"]["last200"]
        against: tuple[str, ...] = ("baseline", *[_NOTHING] * 5)
        if key != results["baseline"]:
            against = _against(arm.get("against_baseline"))
        yield (
            env,
            arm["label"],
            count,
            _score(arm, 200),
            _score(arm, 100),
            f"{last['iqm']:.1f}{_ends(last['iqm_interval'])}",
            *against,
        )


def _against(comparison: Any) -> tuple[str, ...]:  # noqa: ANN401  JSON
    if comparison is None:
        return (_NOTHING,) * 6
    found = comparison["last200"]
    better = found["probability_of_improvement"]
    interval = found["welch_interval"] or found.get("difference_interval")
    return (
        f"{found['difference']:+.1f}{_ends(interval)}",
        _p(found["welch_p"]),
        f"{better:.2f}{_ends(found.get('probability_of_improvement_interval'), 2)}",
        _p(found["brown_forsythe_p"]),
        of_mean(comparison),
        of_spread(comparison),
    )


def on_the_way(results: Results) -> Table | None:
    """Returns before the end; None: the runs are shorter than the first mark."""
    marks = sorted({mark for _, _, arm in _arms(results) for mark in arm["on_the_way"]}, key=int)
    lines = [
        (
            env,
            arm["label"],
            *[
                _pair(one["mean"], one["std_across_seeds"]) if one else _NOTHING
                for one in map(arm["on_the_way"].get, marks)
            ],
        )
        for env, _, arm in _arms(results)
    ]
    head = ("environment", "arm", *[f"{int(mark) / 1e6:g} million steps" for mark in marks])
    return Table(head, lines) if marks else None


def over_environments(results: Results) -> Table | None:
    """Interquartile means over environments; None: there are none."""
    lines = [
        (arm, f"{one['iqm']:.2f}{_ends(one['iqm_interval'], 2)}")
        for arm, one in results["over_environments"].items()
    ]
    head = ("arm", "IQM over environments and seeds, the baseline's mean is 1; last 100")
    return Table(head, lines) if lines else None


def within_policies(results: Results, start: str) -> Table | None:
    """Evaluation episodes; None: there are none. Columns without a number are left out."""
    found = [(env, key, arm) for env, key, arm in _arms(results) if start in arm["evaluation"]]
    if not found:
        return None
    columns: dict[str, list[str]] = {"environment": [], "arm": [], "seeds x episodes": []}
    for env, key, arm in found:
        columns["environment"].append(env)
        columns["arm"].append(arm["label"])
        one = arm["evaluation"][start]
        columns["seeds x episodes"].append(f"{one['seeds']} x {one['episodes_per_seed']}")
        for name, text in _of_policy(arm, start, is_base=key == results["baseline"]):
            columns.setdefault(name, []).append(text)
    columns = {
        name: texts for name, texts in columns.items() if any(text != _NOTHING for text in texts)
    }
    return Table(list(columns), list(zip(*columns.values(), strict=True)))


def _of_policy(arm: Results, start: str, *, is_base: bool) -> Iterator[tuple[str, str]]:
    one = arm["evaluation"][start]
    whole, discounted = one["undiscounted"], one.get("discounted")
    against = (arm.get("against_baseline") or {}).get(start)
    yield "mean", _with_ends(whole, "mean")
    yield "std", _with_ends(whole, "std")
    yield "std / baseline's", _ratio(against, "std")
    yield "mean / baseline's", _ratio(against, "mean")
    yield "CVaR 10 %", _with_ends(whole, "cvar10")
    yield "worst", f"{whole['worst']:.1f}"
    yield "falls", _share(one)
    for name, title in (("mean", "discounted mean"), ("std", "discounted std")):
        yield title, _NOTHING if discounted is None else _with_ends(discounted, name)
    verdict = of_policies(arm["against_baseline"], start) if against else _NOTHING
    yield "against the baseline", "baseline" if is_base else verdict
    goal = of_goal(arm["against_baseline"], start) if against else _NOTHING
    yield "30 % less spread for 5 % of the mean", goal


def calibrations(results: Results) -> Table | None:
    """What `dppo eval` says of σ, mean over seeds; None: nothing."""
    found = [(env, arm) for env, _, arm in _arms(results) if arm["calibration"]]
    names = list(dict.fromkeys(name for _, arm in found for name in arm["calibration"]))
    lines = [
        (env, arm["label"], *[_number(arm["calibration"].get(name)) for name in names])
        for env, arm in found
    ]
    head = ("environment", "arm", *[name.replace("_", " ") for name in names])
    return Table(head, lines) if names else None


def _arms(results: Results) -> Iterator[tuple[str, str, Results]]:
    for env, one in results["environments"].items():
        for key, arm in one["arms"].items():
            yield env, key, arm


def _score(arm: Mapping[str, Any], count: int) -> str:
    if not arm["training"]:
        return _NOTHING
    one = arm["training"][f"last{count}"]
    return _pair(one["mean"], one["std_across_seeds"])


def _pair(mean: float, std: float | None) -> str:
    return f"{mean:.1f}" if std is None else f"{mean:.1f} ± {std:.1f}"


def _ends(interval: Any, digits: int = 1) -> str:  # noqa: ANN401  JSON
    if interval is None:
        return ""
    return f" [{interval[0]:.{digits}f}, {interval[1]:.{digits}f}]"


def _with_ends(one: Results, name: str) -> str:
    return f"{one[name]:.1f}{_ends(one[f'{name}_interval'])}"


def _share(one: Results) -> str:
    if "falls" not in one:
        return _NOTHING
    low, high = one["falls_interval"]
    return f"{one['falls']:.1%} [{low:.1%}, {high:.1%}]"


def _ratio(against: Any, name: str) -> str:  # noqa: ANN401  JSON
    value = (against or {}).get(f"{name}_ratio")
    return (
        _NOTHING if value is None else f"{value:.2f}{_ends(against[f'{name}_ratio_interval'], 2)}"
    )


def _p(value: float | None) -> str:
    return _NOTHING if value is None else f"{value:.2g}"


def _number(value: Any) -> str:  # noqa: ANN401  JSON
    return _NOTHING if value is None else f"{value['mean']:.3g}"
