"""What the numbers say about each claim of the paper, one honest sentence each."""

from collections.abc import Iterator, Sequence
from typing import Any

from dppo.four_rooms.results import MAIN, Results
from dppo.four_rooms.summary import GOOD_RETURN

Summary = dict[str, Any]


def claims(results: Results) -> Iterator[tuple[str, str, str]]:
    """What the paper says, what came out, and whether it holds."""
    plain, safe = (
        next(arm for arm in results["arms"] if arm["key"] == key) for key in ("plain", "safe")
    )
    found, ends = results["comparison"], results["comparison"]["intervals_95"]
    low, high = ends["return_difference"]
    yield (
        "The safe agent performs better (conclusion)",
        f"return {safe['return_mean']:.1f} against {plain['return_mean']:.1f}: "
        f"{found['return_difference']:+.1f} [{low:.1f}, {high:.1f}]",
        _verdict(low > 0, high < 0),
    )
    low, high = ends["return_std_ratio"]
    yield (
        "Its return has a smaller standard deviation (figure 2)",
        f"{safe['return_std_across_trials']:.1f} against {plain['return_std_across_trials']:.1f}: "
        f"{found['return_std_ratio']:.2f} times [{low:.2f}, {high:.2f}]",
        _verdict(high < 1, low > 1),
    )
    fast, slow = safe["episodes_to_good_return"], plain["episodes_to_good_return"]
    yield (
        "It learns faster",
        f"the mean return stays above {GOOD_RETURN:g} from episode {_or_never(fast)} on, "
        f"against {_or_never(slow)}",
        _verdict(*_sooner(fast, slow)) + "; the arms' α_c differ as well",
    )
    low, high = ends["frozen_steps_ratio"]
    yield (
        "It visits frozen cells less often (figure 3)",
        f"{safe['frozen_steps_per_episode']:.2f} frozen steps per episode against "
        f"{plain['frozen_steps_per_episode']:.1f}: {found['frozen_steps_ratio']:.3f} times "
        f"[{low:.3f}, {high:.3f}]; {safe['test']['frozen_time_share']:.1%} of the time in test "
        f"episodes against {plain['test']['frozen_time_share']:.1%}",
        _verdict(high < 1, low > 1),
    )
    onto = {one["key"]: one["learned_cells_onto_ice"] for one in results["optimum"]}
    yield (
        "Its policy leads away from the ice (figure 4)",
        f"from {onto['safe']:.1f} cells beside the ice the likeliest action enters it, against "
        f"{onto['plain']:.1f}",
        _verdict(onto["safe"] < onto["plain"], onto["safe"] > onto["plain"]),
    )
    touching = [one["test"]["episodes_touching_ice"] for one in (safe, plain)]
    least = next(one["test"] for one in results["optimum"] if one["key"] == "safe")
    yield (
        "Whatever the start, it avoids the frozen cells (figure 5)",
        f"{touching[0]:.1%} of the test episodes that begin off the ice step on it, against "
        f"{touching[1]:.1%}; by slips alone, {least['episodes_touching_ice']:.1%} of those of the "
        "optimal policy",
        "holds but for slips and a rest"
        if touching[0] < touching[1] / 2
        else _verdict(False, touching[0] >= touching[1]),
    )


def _verdict(holds: bool, fails: bool) -> str:
    return "holds" if holds else "does not hold" if fails else "not decided by these trials"


def _or_never(episode: int | None) -> str:
    return "never" if episode is None else str(episode)


def _sooner(first: int | None, second: int | None) -> tuple[bool, bool]:
    """Is the first sooner; is the second."""
    if first is None or second is None:
        return first is not None, second is not None
    return first < second, second < first


def of_sweep(arms: Sequence[Summary], optimum: Sequence[Summary]) -> str:
    """One sentence on the sweep, and one on what eq. 9 itself would need."""
    best = max(arms, key=lambda arm: float(arm["return_mean"]))
    least = min(arms, key=lambda arm: float(arm["return_std_across_trials"]))
    exact = {one["psi"]: one for one in optimum}
    text = (
        f"Of these ψ, all with the safe arm's α_c, {best['psi']:g} has the highest return "
        f"({best['return_mean']:.1f}) and {least['psi']:g} the smallest spread "
        f"({least['return_std_across_trials']:.1f}). "
    )
    if best["psi"] > 0 and 0.0 in exact:
        text += (
            "That a penalty raises the return is no property of eq. 9, whose optimum loses "
            "expected return as ψ grows. The likely reason is in the learner: with a constant "
            "step size its Q follows what frozen cells happened to pay last, and the penalty "
            "keeps it away from there. "
        )
    return text + (
        "In the default world, with exact V and σ, ψ = 0.009 is already enough to prefer the way "
        "around the ice from the far corner."
    )


def of_ablations(by_key: dict[str, Summary]) -> Iterator[str]:
    """One sentence for each change."""
    if all(f"{key}, equal α_c" in by_key for key in MAIN) and all(key in by_key for key in MAIN):
        yield _equal_steps(by_key)
    sentences = {
        "printed": "**As printed**, with max over Q and min over σ",
        "expected": "**Expected SARSA**, the policy's mean in place of the next action",
        "baseline": "**A state baseline** in the actor",
        "occupancy": "**The weights of eq. 15**, γ^t and γ̄^t, which Algorithm 1 leaves out",
        "inverse temperature": "**The factor 1/temperature** of ∇ log π, which the authors "
        "leave out",
    }
    for name, beginning in sentences.items():
        plain, safe = (by_key.get(f"{key}, {name}") for key in ("plain", "safe"))
        if plain and safe:
            yield f"{beginning}: {_both(plain, safe)}"


def _equal_steps(by_key: dict[str, Summary]) -> str:
    """Table 1 gives the two arms different α_c: what is left when they are the same."""
    pairs = (
        ("plain", by_key["plain"], by_key["safe, equal α_c"]),
        ("safe", by_key["plain, equal α_c"], by_key["safe"]),
    )
    text = "**Equal α_c.** Table 1 gives the two arms different α_c. "
    for whose, plain, safe in pairs:
        text += (
            f"With the {whose} arm's for both, ψ = {safe['psi']:g} has "
            f"{safe['return_mean']:.1f} ± {safe['return_std_across_trials']:.1f} "
            f"({safe['timeouts_fraction']:.0%} time-outs) against {plain['return_mean']:.1f} ± "
            f"{plain['return_std_across_trials']:.1f} ({plain['timeouts_fraction']:.0%}): "
            f"{_lead(plain, safe)}. "
        )
    return text.strip()


def _lead(plain: Summary, safe: Summary) -> str:
    """Who is ahead in return, spread and frozen steps."""
    higher = safe["return_mean"] > plain["return_mean"]
    smaller = safe["return_std_across_trials"] < plain["return_std_across_trials"]
    drier = safe["frozen_steps_per_episode"] < plain["frozen_steps_per_episode"]
    return (
        f"{'more' if higher else 'less'} return, {'less' if smaller else 'more'} spread, "
        f"{'fewer' if drier else 'more'} frozen steps"
    )


def _both(plain: Summary, safe: Summary) -> str:
    """Returns of both arms, and whether they have learned at all."""
    text = " and ".join(
        f"{arm['return_mean']:.1f} ± {arm['return_std_across_trials']:.1f} with ψ = "
        f"{arm['psi']:g} ({arm['timeouts_fraction']:.0%} time-outs, "
        f"{arm['frozen_steps_per_episode']:.1f} frozen steps)"
        for arm in (plain, safe)
    )
    if min(plain["return_mean"], safe["return_mean"]) < GOOD_RETURN:
        return text + ": with these step sizes that is not a working learner."
    return f"{text}: with ψ, {_lead(plain, safe)}."
