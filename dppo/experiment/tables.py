"""The report's tables."""

from collections.abc import Iterator, Mapping
from typing import Any

from dppo.experiment.claim_rows import rows
from dppo.experiment.claims import claims
from dppo.experiment.numbers import NOTHING, ends, over_seeds, p_value, pair, ratio_of, times
from dppo.experiment.page import Table
from dppo.experiment.results import Results
from dppo.experiment.verdicts import of_mean, of_spread


def beside_the_paper(results: Results) -> Table | None:
    """Table 2, theirs and ours; None: no environment of the paper's has its arms."""
    lines = [
        (
            row.env,
            f"{row.paper.psi:g}",
            pair(*row.paper.plain),
            _score(row.plain, 200),
            pair(*row.paper.safe),
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
        "difference to the baseline", "p", "P(better)", "p, ranks", "spread / baseline's",
        "p, spread", "mean", "spread",
    )  # fmt: skip
    return Table(head, list(_training_rows(results)))


def _training_rows(results: Results) -> Iterator[tuple[str, ...]]:
    for env, key, arm in arms_of(results):
        count = f"{len(arm['seeds'])} of {len(arm['seeds_planned'])}"
        if not arm["training"]:
            yield (env, arm["label"], count, *[NOTHING] * 11)
            continue
        last = arm["training"]["last200"]
        against: tuple[str, ...] = ("baseline", *[NOTHING] * 7)
        if key != results["baseline"]:
            against = _against(arm.get("against_baseline"))
        yield (
            env,
            arm["label"],
            count,
            _score(arm, 200),
            _score(arm, 100),
            f"{last['iqm']:.1f}{ends(last['iqm_interval'])}",
            *against,
        )


def _against(comparison: Any) -> tuple[str, ...]:  # noqa: ANN401  JSON
    if comparison is None:
        return (NOTHING,) * 8
    found = comparison["last200"]
    better = NOTHING
    if min(found["seeds"]) > 1:
        bounds = found["probability_of_improvement_interval"]
        apart = bounds is None or bounds[0] == bounds[1]  # every seed: resamples show no doubt
        better = f"{found['probability_of_improvement']:.2f}{'' if apart else ends(bounds, 2)}"
    return (
        f"{found['difference']:+.1f}{ends(found['welch_interval'])}",
        p_value(found["welch_p"]),
        better,
        p_value(found["mann_whitney_p"]),
        times(found, "std"),
        p_value(found["brown_forsythe_p"]),
        of_mean(comparison),
        of_spread(comparison),
    )


def on_the_way(results: Results) -> Table | None:
    """Returns before the end; None: the runs are shorter than the first mark."""
    marks = sorted({mark for _, _, arm in arms_of(results) for mark in arm["on_the_way"]}, key=int)
    lines = [
        (
            env,
            arm["label"],
            *[
                pair(one["mean"], one["std_across_seeds"]) if one else NOTHING
                for one in map(arm["on_the_way"].get, marks)
            ],
        )
        for env, _, arm in arms_of(results)
    ]
    head = ("environment", "arm", *[f"{int(mark) / 1e6:g} million steps" for mark in marks])
    return Table(head, lines) if marks else None


def moved_psi(results: Results) -> Table | None:
    """What ψ came to where it moves; None: it does so nowhere."""
    lines = [
        (env, arm["label"], f"{len(one['psi']['by_seed'])}", _over_seeds(one["psi"]),
         _over_seeds(one.get("start_sigma")))
        for env, _, arm in arms_of(results)
        if "psi" in (one := arm["moved"])
    ]  # fmt: skip
    head = ("environment", "arm", "seeds", "ψ at the end", "σ(s_0), last tenth of the run")
    return Table(head, lines) if lines else None


def _over_seeds(one: Any) -> str:  # noqa: ANN401  JSON
    return NOTHING if one is None else over_seeds(one["mean"], one["by_seed"], ".3g")


def over_environments(results: Results) -> Table | None:
    """All environments at once, of each arm; None: there is nothing."""
    lines = []
    for arm in dict.fromkeys(key for _, key, _ in arms_of(results)):
        scores, ratios = results["over_environments"].get(arm), results["together"].get(arm, {})
        if scores is None and not ratios:
            continue
        texts = [NOTHING] * 3
        if scores is not None:
            mean, iqm = f"{scores['mean']:.2f}", f"{scores['iqm']:.2f}"
            texts = [f"{scores['seeds']}", mean, iqm + ends(scores["iqm_interval"], 2)]
        lines.append(
            (
                arm,
                *texts,
                *[ratio_of(ratios.get(name)) for name in ("across", "within", "within_mean")],
            )
        )
    head = (
        "arm", "seeds", "mean of the last 100, in units of the baseline's", "IQM of that",
        "spread across seeds / baseline's", "std within a policy / baseline's",
        "mean of these policies / baseline's",
    )  # fmt: skip
    return Table(head, lines) if lines else None


def every_seed(results: Results) -> Table | None:
    """The number of each seed that the table of training returns is made of."""
    seeds = sorted({seed for _, _, arm in arms_of(results) for seed in arm["seeds"]})
    lines = []
    for env, _, arm in arms_of(results):
        if arm["training"]:
            by_seed = dict(zip(arm["seeds"], arm["training"]["last100"]["by_seed"], strict=True))
            scores = [f"{by_seed[seed]:.1f}" if seed in by_seed else NOTHING for seed in seeds]
            lines.append((env, arm["label"], *scores))
    head = ("environment", "arm", *[f"seed {seed}" for seed in seeds])
    return Table(head, lines) if lines else None


def arms_of(results: Results) -> Iterator[tuple[str, str, Results]]:
    """Environment, key and figures of every arm."""
    for env, one in results["environments"].items():
        for key, arm in one["arms"].items():
            yield env, key, arm


def _score(arm: Mapping[str, Any], count: int) -> str:
    if not arm["training"]:
        return NOTHING
    one = arm["training"][f"last{count}"]
    return pair(one["mean"], one["std_across_seeds"])
