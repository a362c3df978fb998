"""The report's first table: the verdicts of all environments on one line a measure."""

import copy

from dppo.experiment.in_short import goal_sentence, in_short
from tests.experiment_results import results_of

OPEN = "no difference that 5 seeds can show"


def lines_of(results):
    """Measure -> verdicts, and what all environments together say."""
    table = in_short(results)
    assert table is not None
    assert {arm for arm, *_ in table.rows} == {"psi-paper"}  # not the baseline
    return {measure: (verdicts, over) for _, measure, verdicts, over in table.rows}


def test_each_measure_has_its_own_verdicts_with_their_environments():
    found = lines_of(
        results_of(
            {
                "Ant-v4": {"mean": "higher", "within": "lower"},
                "Hopper-v4": {"spread": "lower", "policy_mean": "lower"},
                "Walker2d-v4": {"mean": "higher", "within": "higher"},
            }
        )
    )
    assert found["mean return in training"] == (
        f"higher (Ant-v4, Walker2d-v4); {OPEN} (Hopper-v4)",
        "–",
    )
    assert (
        found["its spread across seeds"][0] == f"{OPEN} (Ant-v4, Walker2d-v4); lower (Hopper-v4)"
    )
    assert found["mean of final policies, undiscounted"] == (
        f"{OPEN} (Ant-v4, Walker2d-v4); lower (Hopper-v4)",
        "1.00",
    )
    assert found["std within a policy, undiscounted"] == (
        f"lower (Ant-v4); {OPEN} (Hopper-v4); higher (Walker2d-v4)",
        "1.00",
    )
    assert found["falls of final policies"] == (f"{OPEN} (Ant-v4, Hopper-v4, Walker2d-v4)", "–")


def test_falls_and_the_goal_are_told():
    results = results_of({"Ant-v4": {}, "Hopper-v4": {}})
    for env, falls, spread in (("Ant-v4", -0.2, 0.4), ("Hopper-v4", 0.2, 0.8)):
        found = results["environments"][env]["arms"]["psi-paper"]["against_baseline"]["free"]
        found["terminated"] = {"difference": falls, "interval": [falls - 0.1, falls + 0.1]}
        found["undiscounted"] |= {
            "std_ratio": spread, "std_ratio_interval": [spread - 0.05, spread + 0.05],
            "mean_beyond_goal": {"difference": 0.05, "interval": [0.03, 0.07]},
        }  # fmt: skip
    arms = results_of({"HalfCheetah-v4": {}})["environments"]["HalfCheetah-v4"]["arms"]
    free = arms["psi-paper"]["against_baseline"]["free"]
    free["terminated"] = {"difference": 0.0, "interval": None}  # nobody falls there
    results["environments"]["HalfCheetah-v4"] = {"arms": arms}
    found = lines_of(results)
    assert found["falls of final policies"] == ("lower (Ant-v4); higher (Hopper-v4)", "–")
    goal, _ = found["30 % less std for 5 % of the mean, undiscounted"]
    assert goal.startswith("yes (Ant-v4); no (Hopper-v4); not judged")


def test_the_goal_counts_environments_where_some_arm_reaches_it():
    results = results_of({"Ant-v4": {}, "Hopper-v4": {}, "Walker2d-v4": {}})
    for env, spreads in (("Ant-v4", (0.9, 0.4)), ("Hopper-v4", (0.4, 0.4))):
        arms = results["environments"][env]["arms"]
        for name, spread in zip(("psi-paper", "other"), spreads, strict=True):
            arm = copy.deepcopy(arms["psi-paper"])
            arm["against_baseline"]["free"]["undiscounted"] |= {
                "std_ratio": spread, "std_ratio_interval": [spread - 0.05, spread + 0.05],
                "mean_beyond_goal": {
                    "difference": 0.05, "interval": [0.01 if env == "Ant-v4" else -0.05, 0.07],
                },
            }  # fmt: skip
            arms[name] = arm
    assert goal_sentence(results) == (
        "30 % less spread within a policy for at most 5 % of the mean: of undiscounted returns on "
        "1 of 3 environments (Ant-v4), by the best of 2 arms."
    )


def test_one_seed_says_nothing():
    results = results_of({"Ant-v4": {"mean": "higher"}})
    results["environments"]["Ant-v4"]["arms"]["psi-paper"]["against_baseline"]["last200"][
        "seeds"
    ] = [1, 5]
    assert in_short(results) is None


def test_policies_that_were_not_evaluated_are_left_out():
    results = results_of({"Ant-v4": {"mean": "higher"}})
    del results["environments"]["Ant-v4"]["arms"]["psi-paper"]["against_baseline"]["free"]
    assert set(lines_of(results)) == {"mean return in training", "its spread across seeds"}


def test_the_report_begins_with_it(whole):
    _, _, page = whole
    begin = page.index("## In short")
    assert begin < page.index("## Table 2: the paper's numbers and ours")
    assert "| psi-paper | mean return in training | higher (HalfCheetah-v4) | – |" in page
    assert (
        "| psi-paper | falls of final policies | not judged: no interval (HalfCheetah-v4) | – |"
        in page
    )
