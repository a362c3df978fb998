"""What the paper says of its method besides scores, and what our policies say to it."""

import pytest

from dppo.experiment.claim_rows import rows
from dppo.experiment.claims import claims
from dppo.experiment.claims_discussed import discussed
from dppo.experiment.table2 import ENVIRONMENTS
from tests.experiment_results import results_of


def arms_of(results):
    """Every plain and safe arm, environment after environment."""
    return [arm for one in results["environments"].values() for arm in one["arms"].values()]


def said(words, results):
    """What is said here to the one claim with these words, and the judgement; None: nothing."""
    found = [one[1:] for one in claims(results) if words in one[0]]
    return found[0] if found else None


def everywhere():
    return results_of({env: {} for env in ENVIRONMENTS})


def traded(results, kind, spreads, means):
    """With these ratios of final policies' returns of one kind."""
    for spread, mean, one in zip(spreads, means, results["environments"].values(), strict=True):
        free = one["arms"]["psi-paper"]["against_baseline"]["free"]
        free[kind] = free.get(kind, {}) | {"std_ratio": spread, "mean_ratio": mean}
    return results


@pytest.mark.parametrize("kind", ["undiscounted", "discounted"])
@pytest.mark.parametrize(
    ("spreads", "means", "here", "judgement"),
    [
        # logs of the means -.105 -.223 -.163 -.105: mean -.149, standard error .0281: ± .089
        ((0.5, 0.4, 0.6, 0.5), (0.9, 0.8, 0.85, 0.9),
         "standard deviation, 0.49 times [0.38, 0.64]; mean, 0.86 times [0.79, 0.94]",
         "The claim holds here: both are lower."),
        ((0.5, 0.4, 0.6, 0.5), (1.0, 1.1, 0.9, 1.0), "mean, 1.00 times [0.88, 1.14]",
         "No trade-off shows here: the spread is lower; mean: no difference that these "
         "environments show together."),
        ((0.5, 0.4, 0.6, 0.5), (1.2, 1.3, 1.1, 1.2), "mean, 1.20",
         "No trade-off shows here: the spread is lower; mean: higher."),
        ((2.0, 2.5, 1.6, 2.0), (0.9, 0.8, 0.85, 0.9), "standard deviation, 2.00",
         "The claim does not hold here: higher."),
        ((0.5, 2.0, 0.5, 2.0), (0.9, 0.8, 0.85, 0.9), "standard deviation, 1.00",
         "Not decided: no difference that these environments show together."),
    ],
)  # fmt: skip
def test_a_trade_off_is_a_lower_spread_at_a_lower_mean(kind, spreads, means, here, judgement):
    results = traded(everywhere(), kind, spreads, means)
    found = said(f"trade-off between the mean and the variance of returns (discussion): {kind}",
                 results)  # fmt: skip
    assert here in found[0]
    assert found[1] == judgement


def test_a_spread_that_is_lower_by_the_environments_alone_is_not_decided():
    """Standard errors of .5 on each of 4 environments: .25 together, with 32 degrees ± .51."""
    results = traded(everywhere(), "undiscounted", (0.6, 0.62, 0.6, 0.62), (1.0, 1.1, 0.9, 1.0))
    for one in results["environments"].values():
        found = one["arms"]["psi-paper"]["against_baseline"]["free"]["undiscounted"]
        found["std_ratio_error"] = [0.5, 8.0]
    here, judgement = said("trade-off", results)
    assert "0.61 times [0.59, 0.63], by seeds [0.37, 1.01]" in here
    assert judgement == (
        "Not decided: lower with environments as the sample, not by what seeds differ."
    )


def test_no_trade_off_is_looked_for_on_two_environments_of_one_seed_or_without_a_ratio():
    assert said("trade-off", results_of({"Ant-v4": {}, "Hopper-v4": {}})) is None
    lower = ((0.5, 0.4, 0.6, 0.5), (0.9, 0.8, 0.85, 0.9))
    for spoil in ({"seeds": [1, 5]}, {"undiscounted": {"std_ratio": 0.5}}):  # a mean below 0
        results = traded(everywhere(), "undiscounted", *lower)
        against = results["environments"]["Ant-v4"]["arms"]["psi-paper"]["against_baseline"]
        against["free"] |= spoil
        found = [one for one in discussed(list(rows(results))) if "trade-off" in one[0]]
        assert found == []


@pytest.mark.parametrize(
    ("ends", "here", "judgement"),
    [
        # six of six by chance: 2 / 2⁶ = .031; five of five .0625; seven of eight .070; one of 6
        ((0.1, 0.2, 0.3), "Ant-v4 0.20 (0.37); lower for 6 of the 6 policies",
         "The claim holds here: lower."),
        ((0.5, 0.6, 0.7), "Ant-v4 0.60 (0.37); lower for 0 of the 6 policies",
         "The claim does not hold here: higher."),
        ((0.1, 0.2, 0.5), "lower for 4 of the 6 policies",
         "Not decided: no difference that 6 policies can show."),
        ((0.37, 0.37), "lower for 0 of the 0 policies",
         "Not decided: no difference that 0 policies can show."),
        ((0.1, 0.2, 0.3, 0.37), "lower for 6 of the 6 policies",
         "The claim holds here: lower."),
        ((0.1, 0.2), "lower for 4 of the 4 policies",
         "Not decided: no difference that 4 policies can show."),
    ],
)  # fmt: skip
def test_a_policy_is_more_deterministic_if_its_actions_spread_less_than_at_the_start(
    ends, here, judgement
):
    results = results_of({"Ant-v4": {}})
    for arm in arms_of(results):
        arm["action_std"] = {"start": 0.37, "by_seed": list(ends)}
    found = said("deterministic", results)
    assert here in found[0]
    assert found[1] == judgement


@pytest.mark.parametrize(
    ("fixed", "here", "judgement"),
    [
        # (s / 2)² = .9025 .81 .9025 .81; geometric mean .855
        ((1.9, 1.8, 1.9, 1.8), "HalfCheetah-v4 0.90, Hopper-v4 0.81, ",
         "The claim does not hold here: most of it is the policy's own randomness."),
        ((0.4, 0.5, 0.4, 0.5), "together, 0.05 times",
         "The claim holds here: most of it comes with the start."),
        ((0.4, 1.9, 0.4, 1.9), "together, 0.19 times", "Not decided: on either side of a half."),
        ((1.9, 1.9, 1.9, 1.9), "together, 0.90 times",
         "Not decided: too few environments, or no interval."),
    ],
)  # fmt: skip
def test_what_is_left_from_one_start_is_the_policys_own_randomness(fixed, here, judgement):
    results = everywhere()
    for std, one in zip(fixed, results["environments"].values(), strict=True):
        for arm in one["arms"].values():
            arm["evaluation"] = {
                start: {"undiscounted": {"std_by_seed": stds}, "length_mean": 1.0, "falls": 0.0}
                for start, stds in (("free", [2.0, 2.0]), ("fixed", [std, std]))
            }
    found = said("stochasticity", results)
    assert here in found[0]
    assert found[1] == judgement


def test_policies_without_spread_or_without_episodes_from_one_start_say_nothing_of_its_source():
    assert said("stochasticity", everywhere()) is None  # nothing was played from one start
    results = results_of({"Ant-v4": {}})
    for arm in arms_of(results):
        stds = {"undiscounted": {"std_by_seed": [0.0, 1.0]}}
        arm["evaluation"] = {"free": arm["evaluation"]["free"] | stds, "fixed": stds}
    assert said("stochasticity", results) is None


@pytest.mark.parametrize(
    ("part", "where"), [("along", "along the way"), ("start", "at the start")]
)
@pytest.mark.parametrize(
    ("verdicts", "here", "judgement"),
    [
        (["within", "within"], "4 within 25 %, 0 outside, 0 open",
         "The claim holds here, within 25 %."),
        (["within", "open"], "2 within 25 %, 0 outside, 2 open",
         "Not decided within 25 % for 2 of 4 policies."),
        (["outside", "open"], "0 within 25 %, 2 outside, 2 open",
         "Does not hold within 25 % for 2 of 4 policies; it holds for 0, and is not decided for "
         "2."),
    ],
)  # fmt: skip
def test_sigma_is_the_variance_if_no_policy_is_off_by_more_than_the_goal(
    part, where, verdicts, here, judgement
):
    results = results_of({"Ant-v4": {}})
    for arm, ratios in zip(arms_of(results), ([1.2, 0.9], [1.1, 0.8]), strict=True):
        arm["calibration"] = {part: {"by_seed": ratios, "verdicts": verdicts}}
    found = said(f"equation 8): {where}", results)
    assert found[0].startswith(
        "predicted over empirical standard deviation 0.80 to 1.20, median 1.00; "
    )
    assert here in found[0]
    assert found[1] == judgement


def test_sigma_without_intervals_is_not_judged():
    results = results_of({"Ant-v4": {}})
    for arm, calibration in zip(
        arms_of(results), (None, {"along": {"by_seed": [1.0]}}), strict=True
    ):
        arm["calibration"] = calibration
    assert said("equation 8", results) is None
