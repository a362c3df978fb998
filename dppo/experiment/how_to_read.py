"""The report's explanations of its tables."""

from collections.abc import Sequence

from dppo.experiment.claims_discussed import OF_SIGMA
from dppo.experiment.compare import LAST
from dppo.experiment.results import Results
from dppo.experiment.significance import LEAST_FOR_SPREAD, power_of_brown_forsythe
from dppo.experiment.tables import arms_of

IN_SHORT = (
    "Each verdict is explained at its table below: mean and spread in training under *Every arm*, "
    "the others under *Within a policy*, the last column under *Over all environments*."
)
POLICIES = (
    "Of the final policy of each seed, not the best, with sampled actions as in training; the"
    " same start states for all arms and seeds. *Std*: standard deviation over the episodes "
    "of one policy, mean over seeds; brackets there: 95 %, episodes resampled within "
    "resampled seeds, too narrow with few seeds. *Falls*: share of episodes that terminated; "
    "Student's interval over seeds; where all seeds agree, or there is one, the exact one of "
    "the episodes of these policies, which says nothing of other seeds. Of a single seed all "
    "brackets are of its episodes alone. Against the baseline one number a seed is compared, "
    "with Welch's 95 % interval: ratios are of geometric means over seeds, by logarithms. *30"
    " % less spread for 5 % of the mean*: *yes* if the interval of the ratio of spreads is "
    "below 0.7 and that of the mean minus 0.95 of the baseline's (1.05, where that is below 0) "
    "above 0, *no* if one of them excludes that, else *open*. Where episodes end in falls, the "
    "undiscounted spread is mostly that of their lengths; the discounted one shows the next "
    "hundred steps or so."
)
SIGMA = (
    "σ predicts the variance of the λ-return; its root is set beside the standard deviation "
    "of what was played. *Along the way*: over the states of the evaluation episodes from the"
    " fixed start, but for those near the time limit, against returns minus V, so errors of V"
    " count; *from TD errors*, against the mean discounted sum of squared TD errors, which σ "
    "is trained on; *worst tenth*: along the way, of the tenths of all steps by their σ, the one "
    "whose ratio is farthest from 1. *At the start*: in that one state, over its episodes; where "
    "nearly nothing is random yet, σ's error there is large against so small a spread. Its *from "
    "TD errors* differs from the empirical one as far as V is wrong. Ratios: geometric means "
    "over seeds."
)
TOGETHER = (
    "*Mean* and *IQM* are over environments and seeds, each score in units of the baseline's "
    "mean there; the interquartile mean leaves out the lowest and the highest quarter, which "
    "may be a whole environment. Ratios are geometric means over environments of the ratios "
    "in the tables; brackets: Student's 95 % interval of their logarithms, environments taken"
    " as a sample, and behind it Satterthwaite's, of these environments alone, by what seeds "
    "differ. The first is too narrow where ratios agree by chance, so *lower* or *higher* is said "
    "where both leave out 1. They are the report's primary comparison of spreads: a single "
    "environment shows little with few seeds."
)


def training(results: Results) -> str:
    """What the columns of the table of training returns are."""
    last = " and ".join(str(count) for count in LAST)
    tests = (
        ""
        if results["intervals"]["tests"]
        else " SciPy is not installed, so all tests and Welch's interval are missing."
    )
    compared = sum(
        min(arm["against_baseline"]["last200"]["seeds"]) > 1
        for _, _, arm in arms_of(results)
        if arm.get("against_baseline")
    )
    return (
        f"Mean return of the last {last} training episodes of each seed; ± is the standard "
        "deviation across seeds (n - 1). *IQM*: interquartile mean over seeds, with fewer than "
        "four the mean. Brackets: 95 % intervals; of the IQM and of the probability of "
        "improvement by resampling seeds within each arm, too narrow with few seeds; of the "
        "difference by Welch; of the ratio of spreads by F, which takes scores to be normal. "
        "*P(better)*: that a seed of this arm beats one of the baseline. *p, ranks*: Mann and "
        "Whitney's test of that. *p, spread*: Brown-Forsythe, "
        f"of equal spreads across seeds.{_power(results)} Judged at 5 %, each on its own: of "
        f"{compared} comparisons of arms that are equal, up to {0.05 * compared:.2g} would look "
        "different in each column, and all arms lean on the same baseline runs, so they err "
        f"together.{_short_runs(results)}{tests}"
    )


def _power(results: Results) -> str:
    """How little the test of spreads can find with so few seeds."""
    arms = (len(arm["seeds"]) for _, _, arm in arms_of(results))
    seeds = min((count for count in arms if count > 1), default=0)
    if 0 < seeds < LEAST_FOR_SPREAD:
        return f" With {seeds} seeds an arm it can find none."
    powers = [power_of_brown_forsythe(seeds, times) for times in (0.5, 0.25)]
    if None in powers:
        return ""
    half, quarter = powers
    return (
        f" It finds little with few seeds: with {seeds} an arm, a spread half as large in "
        f"{half:.0%} of all cases, a quarter as large in {quarter:.0%} (normal scores, simulated)."
    )


def _short_runs(results: Results) -> str:
    trained = [arm["training"] for _, _, arm in arms_of(results) if arm["training"]]
    fewest = min((one["last200"]["fewest_episodes"] for one in trained), default=200)
    return f" Some runs have only {fewest} training episodes in all." if fewest < 200 else ""


def claims(results: Results, found: Sequence[str]) -> str:
    """How these runs differ from the paper's, and what judgements of its claims are worth."""
    judged = sum(not claim.startswith(OF_SIGMA) for claim in found)
    other = results["unlike_the_paper"]
    return (
        "Not the paper's experiment again, but its question: other versions of the environments, "
        "of MuJoCo and of the trainer. Settings that are not those of `--preset paper` on "
        f"{other['env']}: {', '.join(other['settings']) or 'none'}. The paper does not say how "
        "its ± was taken; the mean of each seed's last 200 episodes, and the standard deviation "
        "of those means, is what its words say. Each claim, but those of σ, is judged on its own, "
        f"at 5 %: of {judged} that say nothing true, up to {0.05 * judged:.2g} would be judged "
        "one way or the other, and reports of a growing grid, looked at again and again, err more "
        "often. The paper's batches are whole episodes; here slots have a fixed number of steps."
    )


def best_seeds(results: Results) -> str:
    """How they were chosen, and how to see one again."""
    found = [arm["evaluation"] for _, _, arm in arms_of(results)]
    counts = sorted({one[start]["episodes_per_seed"] for one in found for start in one})
    return (
        "Chosen by the last 100 training episodes. The two last columns, mean ± standard "
        "deviation, are `return_mean` and `return_std` of `dppo eval RUN --which newest "
        f"--episodes {' or '.join(map(str, counts))} --fixed-start`; `dppo watch RUN` shows one."
    )
