"""What the paper says of its method besides scores: of σ, of randomness, of what safety costs."""

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from dppo.experiment.calibrated import OPEN, OUTSIDE, WITHIN
from dppo.experiment.claim_rows import Claim, Row, judged, times, times_together
from dppo.experiment.significance import SIGNIFICANT, Ratio, ratio_over
from dppo.experiment.together import FEWEST, WITHIN_POLICIES, measures
from dppo.experiment.verdicts import Summary, of_ratio

OF_SIGMA = "The variance of the λ-return is estimated directly, by temporal differences"
"""Claims that begin so are of an interval per policy, not of one test."""
_MAINLY = 0.5
"""Of a variance: more than half is most of it."""


def discussed(found: list[Row]) -> Iterator[Claim]:
    """Claims about the policies with ψ = 0 and with the paper's ψ, taken together."""
    yield from _of_trade(found)
    yield from _of_determinism(found)
    yield from _of_stochasticity(found)
    yield from _of_sigma(found, "along", "along the way")
    yield from _of_sigma(found, "start", "at the start, where equation 9 penalises it")


def _of_trade(found: list[Row]) -> Iterator[Claim]:
    ratios = measures([row.safe for row in found])
    for kind, name in WITHIN_POLICIES.items():
        spread, mean = ratios.get(name), ratios.get(f"{name}_mean")
        if spread and mean:
            yield (
                "Constraining the variance leads to a trade-off between the mean and the variance "
                f"of returns (discussion): {kind} ones",
                "of final policies from free starts, over all environments together: standard "
                f"deviation{times_together(spread)}; mean{times_together(mean)}",
                _traded(of_ratio(spread), of_ratio(mean)),
            )


def _traded(spread: str, mean: str) -> str:
    if spread != "lower":
        return judged(spread, "lower")
    if mean == "lower":
        return "The claim holds here: both are lower."
    return f"No trade-off shows here: the spread is lower; mean: {mean}."


def _of_determinism(found: list[Row]) -> Iterator[Claim]:
    lower, total, parts = 0, 0, []
    for row in found:
        pairs = [
            (std, one["start"])
            for arm in (row.plain, row.safe)
            if (one := arm.get("action_std"))
            for std in one["by_seed"]
        ]
        if pairs:
            ends, starts = np.mean(pairs, axis=0)
            lower += sum(end < start for end, start in pairs)
            total += sum(end != start for end, start in pairs)
            parts.append(f"{row.env} {ends:.2f} ({starts:.2f})")
    if parts:
        yield (
            "Improvement leads the policy towards a deterministic nature (discussion)",
            "standard deviation of actions, mean over dimensions, at the end (at the start): "
            f"{', '.join(parts)}; lower for {lower} of the {total} policies that have changed it",
            judged(_of_signs(lower, total), "lower"),
        )


def _of_signs(lower: int, total: int) -> str:
    """Sign test, two-sided."""
    most = max(lower, total - lower)
    tail = sum(math.comb(total, count) for count in range(most, total + 1)) / 2**total
    if 2 * tail >= SIGNIFICANT:
        return f"no difference that {total} policies can show"
    return "lower" if lower == most else "higher"


def _of_stochasticity(found: list[Row]) -> Iterator[Claim]:
    shares = {row.env: shares for row in found if (shares := _shares_of_the_policy(row))}
    if not shares:
        return
    means = {env: float(np.exp(np.mean(np.log(one)))) for env, one in shares.items()}
    listed = ", ".join(f"{env} {one:.2f}" for env, one in means.items())
    over = ratio_over(np.array([*means.values()])) if len(means) >= FEWEST else None
    yield (
        "After a time the variance in return mainly reflects the environment's stochasticity "
        "(discussion), which here is where an episode starts",
        "from one start, the same for all policies, where nothing but the actions is random, "
        f"returns have of the variance from free starts: {listed}"
        + (f"; together{times(over.value, over.interval)}" if over else ""),
        _of_share(over),
    )


def _shares_of_the_policy(row: Row) -> list[float]:
    """Variance of returns from one start over that from free ones, of each policy."""
    found: list[float] = []
    for arm in (row.plain, row.safe):
        fixed, free = (_stds(arm, start) for start in ("fixed", "free"))
        if len(fixed) == len(free) and min([*fixed, *free], default=0) > 0:
            found += [(one / other) ** 2 for one, other in zip(fixed, free, strict=True)]
    return found


def _stds(arm: Summary, start: str) -> Sequence[float]:
    stds: Sequence[float] = (
        arm["evaluation"].get(start, {}).get("undiscounted", {}).get("std_by_seed", [])
    )
    return stds


def _of_share(over: Ratio | None) -> str:
    if over is None or over.interval is None:
        return "Not decided: too few environments, or no interval."
    low, high = over.interval
    if low > _MAINLY:
        return "The claim does not hold here: most of it is the policy's own randomness."
    if high < _MAINLY:
        return "The claim holds here: most of it comes with the start."
    return "Not decided: on either side of a half."


def _of_sigma(found: list[Row], part: str, where: str) -> Iterator[Claim]:
    ones: list[dict[str, Any]] = [
        one[part]
        for row in found
        for arm in (row.plain, row.safe)
        if "verdicts" in (one := arm.get("calibration") or {}).get(part, {})
    ]
    if not ones:
        return
    ratios = [ratio for one in ones for ratio in one["by_seed"]]
    verdicts = [verdict for one in ones for verdict in one["verdicts"]]
    within, outside, still_open = (verdicts.count(verdict) for verdict in (WITHIN, OUTSIDE, OPEN))
    if within == len(verdicts):
        judgement = "The claim holds here, within 25 %."
    elif outside:
        judgement = (
            f"Does not hold within 25 % for {outside} of {len(verdicts)} policies; it holds for "
            f"{within}, and is not decided for {still_open}."
        )
    else:
        judgement = f"Not decided within 25 % for {still_open} of {len(verdicts)} policies."
    yield (
        f"{OF_SIGMA} (abstract, equation 8): {where}",
        f"predicted over empirical standard deviation {min(ratios):.2f} to {max(ratios):.2f}, "
        f"median {np.median(ratios):.2f}; by their intervals, of the {len(verdicts)} policies "
        f"with ψ 0 or the paper's: {within} within 25 %, {outside} outside, {still_open} open",
        judgement,
    )
