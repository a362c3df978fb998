"""The paper's claims about all of its environments."""

from collections.abc import Callable

from dppo.experiment.claim_rows import Claim, Row, cost, judged, named, times_together
from dppo.experiment.paper import TABLE_2
from dppo.experiment.together import measures
from dppo.experiment.verdicts import Summary, of_mean, of_ratio, of_spread


def in_all(found: list[Row]) -> Claim:
    """A boost everywhere; a lower spread that is bought with a lower mean is none."""
    shown = [
        row.env
        for row in found
        if (mean := of_mean(row.comparison)) == "higher"
        or (of_spread(row.comparison) == "lower" and mean != "lower")
    ]
    return (
        "Safety boosts performance in all 4 environments, in mean or in spread",
        f"shown in {len(shown)} of {len(found)} environments{named(shown)}",
        _in_all_four(found, len(shown)),
    )


def outperforms(found: list[Row]) -> Claim:
    """A higher mean everywhere."""
    higher, lower = (_where(found, of_mean, verdict) for verdict in ("higher", "lower"))
    verdict = "Does not hold here." if lower else _in_all_four(found, len(higher))
    return (
        "It outperforms DPPO in all the environments (key contributions); its own Table 2 has a "
        "lower mean on Walker2d",
        f"mean higher in {len(higher)} of {len(found)}{named(higher)}, lower in "
        f"{len(lower)}{named(lower)}",
        verdict,
    )


def reduces(found: list[Row]) -> Claim:
    """A lower spread, judged by all of them together: a single one shows little with few seeds."""
    higher, lower = (_where(found, of_spread, verdict) for verdict in ("higher", "lower"))
    ratio = measures([row.safe for row in found]).get("across")
    if len({row.paper.env for row in found}) < len(TABLE_2):
        judgement = _in_all_four(found, 0)
    elif higher:
        judgement = f"The claim does not hold here: higher{named(higher)}."
    else:
        judgement = judged(of_ratio(ratio), "lower", _costs(found))
    return (
        "A significant reduction in the standard deviation of the scores in all the environments "
        "(abstract); from its own numbers it is significant in none",
        f"spread across seeds lower in {len(lower)} of {len(found)}{named(lower)}, higher in "
        f"{len(higher)}{named(higher)}; all of them together"
        + (times_together(ratio) if ratio else ": no ratio"),
        judgement,
    )


def _costs(found: list[Row]) -> str:
    """Where the mean is lower and the paper's is not."""
    envs = [row.env for row in found if cost(row, of_mean(row.comparison))]
    return f"at a lower mean{named(envs)}" if envs else ""


def _where(found: list[Row], judge: Callable[[Summary], str], verdict: str) -> list[str]:
    """Environments with this verdict."""
    return [row.env for row in found if judge(row.comparison) == verdict]


def _in_all_four(found: list[Row], shown: int) -> str:
    """Whether what is claimed of all environments is shown in all of them."""
    there = len({row.paper.env for row in found})
    if there < len(TABLE_2):
        return f"Not decided: {there} of the {len(TABLE_2)} environments were run."
    return "Holds here." if shown == len(found) else "Not shown here in all of them."
