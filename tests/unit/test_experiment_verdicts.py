"""Judgements of an experiment's report: from intervals and tests alone."""

from typing import Any

import numpy as np
import pytest

from dppo.experiment.claim_rows import rows
from dppo.experiment.compare import returns_of_policies
from dppo.experiment.verdicts import of_goal, of_interval, of_policies, of_spread
from tests.experiment_folders import evaluated, leave, planned, report_of


@pytest.mark.parametrize(
    ("interval", "seeds", "sentence"),
    [
        ((0.1, 2.0), 5, "higher"),
        ((-2.0, -0.1), 5, "lower"),
        ((-0.1, 2.0), 5, "no difference that 5 seeds can show"),
        ((0.0, 2.0), 3, "no difference that 3 seeds can show"),
        ((0.1, 2.0), 1, "one seed shows nothing"),
        (None, 5, "not judged: no interval"),
    ],
)
def test_judgements_follow_the_interval(interval, seeds, sentence):
    assert of_interval(interval, seeds) == sentence


def against(std, mean, seeds=5):
    """A comparison with this ratio of spreads, and a mean so many times the baseline's, 100."""
    found: dict[str, Any] = {"std_ratio": std, "std_ratio_interval": [std - 0.1, std + 0.1]}
    beyond = 100 * (mean - 0.95)
    found["mean_beyond_goal"] = {"difference": beyond, "interval": [beyond - 10, beyond + 10]}
    found["mean"] = {"interval": [-1.0, 1.0]}
    return {"free": {"seeds": [seeds, 5], "undiscounted": found}}


@pytest.mark.parametrize(
    ("std", "mean", "sentence"),
    [
        (0.5, 1.1, "yes"),
        (0.65, 1.1, "open; the estimate reaches it"),
        (0.5, 1.0, "open; the estimate reaches it"),
        (0.75, 1.1, "open; the estimate misses it"),
        (0.5, 0.9, "open; the estimate misses it"),
        (0.85, 1.1, "no"),
        (0.5, 0.8, "no"),
    ],
)
def test_a_goal_is_reached_or_missed_when_intervals_say_so_and_else_open(std, mean, sentence):
    assert of_goal(against(std, mean), "free", "undiscounted") == sentence


@pytest.mark.parametrize(
    ("times", "below", "sentence"),
    # of means around -100 or 100, one of them 10 above: the goal is 5 % of them
    [
        (-1, 0, "yes"),
        (-1, 10, "no"),
        (1, 0, "yes"),
        (1, 10, "no"),
    ],
)
def test_a_mean_below_0_may_be_5_percent_lower_too(times, below, sentence):
    around = times * 100 + np.array([-0.5, 0.5, 0.0])[:, None]
    apart = np.array([-1.0, 1.0, -1.0, 1.0])
    ours, theirs = around - below + 0.1 * np.array([[1], [2], [3]]) * apart, around + 9 * apart
    theirs[0] *= 0.999  # or all spreads would be equal
    found = {"free": {"seeds": [3, 3], "undiscounted": returns_of_policies(ours, theirs)}}
    assert of_goal(found, "free", "undiscounted") == sentence


def test_a_baseline_with_means_on_both_sides_of_0_is_judged():
    apart = np.array([-1.0, 1.0, -1.0, 1.0])
    theirs = np.array([[-50.0], [20.0], [90.0]]) + [[9], [10], [11]] * apart
    ours = np.array([[900.0], [1000.0], [1100.0]]) + [[1], [2], [3]] * apart
    found = returns_of_policies(ours, theirs)
    assert "mean_ratio" not in found
    comparison = {"free": {"seeds": [3, 3], "undiscounted": found}}
    assert of_goal(comparison, "free", "undiscounted") == "yes"


def test_one_seed_decides_nothing_about_policies():
    one = against(0.1, 2.0, seeds=1)
    assert of_goal(one, "free", "undiscounted") == "one seed shows nothing"
    sentence = "spread one seed shows nothing; mean one seed shows nothing"
    assert of_policies(one, "free", "undiscounted") == sentence


@pytest.mark.parametrize(
    ("stds", "p", "sentence"),
    [
        ([100.0, 400.0], 0.01, "lower"),
        ([400.0, 100.0], 0.01, "higher"),
        ([400.0, 0.0], 0.03, "higher"),  # a baseline without any spread has no ratio
        ([100.0, 400.0], 0.06, "no difference that 5 seeds can show"),
        ([100.0, 400.0], float("nan"), "no difference that 5 seeds can show"),
        ([0.0, 0.0], None, "not judged: seeds differ from their median all by the same"),
    ],
)
def test_a_spread_is_lower_or_higher_as_the_standard_deviations_are(stds, p, sentence):
    found = {"seeds": [5, 5], "brown_forsythe_p": p, "stds": stds, "distances": stds}
    assert of_spread({"last200": found}) == sentence
    few = of_spread({"last200": found | {"seeds": [5, 3], "brown_forsythe_p": None}})
    assert few == "not judged: fewer than 4 seeds"


def test_a_spread_is_not_judged_where_what_was_tested_lies_the_other_way():
    """Brown and Forsythe compare distances to the medians: an outlier may turn the deviations."""
    found = {"seeds": [9, 9], "brown_forsythe_p": 0.03, "stds": [4.0, 3.0]}
    assert of_spread({"last200": found | {"distances": [2.0, 1.0]}}) == "higher"
    assert of_spread({"last200": found | {"distances": [1.0, 2.0]}}) == (
        "not judged: standard deviations and distances to the medians disagree"
    )


def test_the_spread_of_policies_without_any_is_judged_by_the_difference():
    found = {"std": {"interval": [-9.0, -1.0]}, "mean": {"interval": [-1.0, 1.0]}}
    sentence = of_policies({"free": {"seeds": [5, 5], "x": found}}, "free", "x")
    assert sentence == "spread lower; mean no difference that 5 seeds can show"


@pytest.mark.slow
def test_a_claim_whose_numbers_one_arm_lacks_is_left_out(tmp_path):
    folder, grid = planned(tmp_path, envs=("Ant-v4",))
    for run in grid.runs:
        facts = evaluated(10.0 + run.seed, 1000.0, fell=True)
        if run.psi == 0:
            for episode in facts["episodes"]:
                del episode["terminated"]
        leave(folder, run, 100.0 * run.seed, **facts)
    _, page = report_of(folder)
    assert "consistent behaviour" in page
    assert "life-span" not in page


def test_the_papers_row_is_of_the_arm_that_differs_in_psi_alone():
    arm: dict[str, Any] = {"psi": 0.075, "against_baseline": {"last200": {}}}
    arms = {
        "plain": {"psi": 0.0, "settings": {"psi": 0.0}, "is_plain": True},
        "joint": arm | {"settings": {"psi": 0.075, "adv_norm": "joint"}},
        "safe": arm | {"settings": {"psi": 0.075}, "label": "safe"},
    }
    results = {"baseline": "plain", "environments": {"Hopper-v4": {"arms": arms}}}
    (row,) = rows(results)
    assert row.safe["label"] == "safe"


def test_every_claim_has_a_row_with_the_papers_own_significance(tmp_path):
    folder, grid = planned(tmp_path, envs=("Ant-v4",), steps=2_000_000)
    for run in grid.runs:
        fell = run.psi == 0 and run.seed % 2 == 1
        leave(folder, run, 100.0 * run.seed, **evaluated(10.0 + run.seed, 1000.0, fell=fell))
    _, page = report_of(folder)
    table = page.split("## The paper's claims")[1].split("##")[0]
    for words in (
        "Mean 2342.1 against 808.7: higher (Welch's test from these numbers: p = 0.0013)",
        "difference +0.0 [-230.6, 230.6]; the paper's +1533.4 lies outside",
        "lower (F test from these numbers: p = 0.42)",
        "behaviour (the paper says it of Walker2d) | returns of one policy's episodes spread by",
        "longer life-span | episodes of 10 steps against 10, difference +0; falls 0% against 60%",
        "learning is faster",
        "significant in none | spread across seeds lower in 0 of 1",
    ):
        assert words in table, words
    assert "gamma_start 0.99 (paper -1.0)" in page
