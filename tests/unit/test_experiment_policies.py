"""What a report says of final policies: their returns, and σ."""

import json

import numpy as np
import pytest

from dppo.distributions import mean_std
from dppo.experiment.significance import ratio
from tests.experiment_folders import PLAIN, SAFE, evaluated, leave, planned, report_of


@pytest.mark.parametrize("start", ["free", "fixed"])
def test_policies_are_compared_by_one_number_a_seed(whole, start):
    _, results, page = whole
    arms = results["environments"]["HalfCheetah-v4"]["arms"]
    plain, safe = (arms[arm]["evaluation"][start] for arm in ("psi0", "psi-paper"))
    # ± s twice each, s = 101 .. 105: a sample's standard deviation is √(4 s² / 3)
    assert plain["undiscounted"]["std"] == pytest.approx(103 * (4 / 3) ** 0.5)
    assert plain["discounted"]["std"] == pytest.approx(103 * (4 / 3) ** 0.5 / 2)
    assert safe["undiscounted"]["cvar10"] == pytest.approx(7020 - 13)
    assert plain["undiscounted"]["worst"] == 1000 - 101
    low, high = plain["undiscounted"]["mean_interval"]
    assert low < plain["undiscounted"]["mean"] < high
    for name in ("std", "cvar10"):  # of four episodes resamples spread less
        low, high = plain["undiscounted"][f"{name}_interval"]
        assert low < high < 10_000
    assert (plain["falls"], safe["falls"]) == (1.0, 0.0)
    found = arms["psi-paper"]["against_baseline"][start]
    for kind in ("undiscounted", "discounted"):
        expected = ratio(*(np.array(one[kind]["std_by_seed"]) for one in (safe, plain)))
        assert expected is not None
        assert found[kind]["std_ratio"] == pytest.approx(expected.value)
        assert found[kind]["std_ratio_interval"] == pytest.approx(expected.interval)
    gain = sum(SAFE) / 5 - sum(PLAIN) / 5
    assert found["undiscounted"]["mean"]["difference"] == pytest.approx(gain)
    assert found["terminated"]["difference"] == -1
    assert f"from {'free start states' if start == 'free' else 'one fixed start state'}" in page
    assert "| 100.0% [83.2%, 100.0%] |" in page  # 20 of 20: Clopper and Pearson
    assert "spread lower; mean higher | yes |" in page
    assert "Within a policy: discounted returns from" in page


def test_how_random_final_policies_are_stands_beside_how_they_began(whole):
    _, results, page = whole
    arms = results["environments"]["HalfCheetah-v4"]["arms"]
    plain, safe = (arms[arm]["action_std"] for arm in ("psi0", "psi-paper"))
    assert plain["start"] == safe["start"] == mean_std(np.array([-1], np.float32))
    assert plain["by_seed"] == pytest.approx([0.101, 0.102, 0.103, 0.104, 0.105])
    assert safe["by_seed"] == pytest.approx([0.011, 0.012, 0.013, 0.014, 0.015])
    assert "HalfCheetah-v4 0.06 (0.37); lower for 10 of the 10 policies" in page


def test_policies_of_which_no_randomness_is_known_say_nothing_of_it(tmp_path):
    folder, grid = planned(tmp_path)
    for number, run in enumerate(grid.runs):
        settings = {"action_std": None} if number % 2 else {}
        leave(folder, run, 100.0, **evaluated(1.0, 100.0) | {"settings": settings})
    results, page = report_of(folder)
    arms = results["environments"]["HalfCheetah-v4"]["arms"].values()
    assert [arm["action_std"] for arm in arms] == [None] * 3
    assert "stochasticity" in page  # what is said of the same policies otherwise
    assert "deterministic nature" not in page


def test_the_calibration_is_a_geometric_mean_over_seeds(whole):
    _, results, page = whole
    found = results["environments"]["HalfCheetah-v4"]["arms"]["psi0"]["calibration"]
    product = 1.0
    for score in PLAIN:
        product *= score / 4000
    assert found["start"]["geometric_mean"] == pytest.approx(product ** (1 / 5))
    assert found["predicted_std"]["mean"] == pytest.approx(17**0.5)  # (3² + 5²) / 2
    assert found["empirical_std"]["mean"] == pytest.approx(12.5**0.5)
    # 1000 and 5600 of 4000 are not within 25 %, nor 1600; 3200 and 4100 are; 70.. of 4000 never
    assert (
        "Within 25 %: along the way of 15 of 15 policies; against TD errors of 15 of 15 policies; "
        "at the start of 2 of 15 policies." in page
    )
    assert "| 1.25 (seeds: 1.25 to 1.25) | 1.10 (seeds: 1.10 to 1.10) | – |" in page
    assert "| 0.65 (seeds: 0.25 to 1.40) |" in page


def test_a_sigma_of_nothing_is_not_left_out_of_its_mean(tmp_path):
    folder, grid = planned(tmp_path, seeds=2)
    for run in grid.runs:
        facts = evaluated(10.0 + run.seed, 1000.0)
        facts["calibration"] |= {"ratio": 0.0 if run.seed == 1 else 1.0, "along_ratio": None}
        leave(folder, run, 1000.0, **facts)
    _, page = report_of(folder)
    assert "| 0.00 (seeds: 0.00 to 1.00) |" in page
    assert "at the start of 3 of 6 policies" in page


def test_sigma_is_judged_by_intervals_too_and_its_worst_tenth_is_shown(tmp_path):
    folder, grid = planned(tmp_path, seeds=3)
    for run in grid.runs:
        facts = evaluated(10.0 + run.seed, 1000.0)
        ends = {1: (0.81, 1.24), 2: (1.26, 1.5), 3: (0.7, 1.1)}[run.seed]
        tenths = [(3.0, 3.0), (2.0, 1.0), (1.0, 3.0 + run.seed), (1.0, 0.0)]
        if run.seed == 3 and run.psi > 0.2:
            tenths[2] = (0.0, 1.0)  # a linear σ may be below 0
        bins = [{"predicted_std": std, "empirical_std": found} for std, found in tenths]
        facts["calibration"] |= {"along_ratio_interval": list(ends), "bins": bins}
        leave(folder, run, 1000.0, **facts)
    results, page = report_of(folder)
    found = results["environments"]["HalfCheetah-v4"]["arms"]["psi0"]["calibration"]
    assert found["along"]["verdicts"] == ["within", "outside", "open"]
    assert found["worst_tenth"]["by_seed"] == [1 / 4, 1 / 5, 1 / 6]
    counts = "(by its 95 % interval within for 3, outside for 3, open for 3)"
    assert f"along the way of 9 of 9 policies {counts}; against TD errors of" in page
    assert "| 0.17 to 0.25 |" in page
    assert "| 0.00 to 0.25 |" in page


def test_an_evaluation_of_fewer_episodes_is_made_again(tmp_path):
    folder, grid = planned(tmp_path, evaluate=4)
    run = grid.runs[0]
    leave(folder, run, 1000.0, **evaluated(10.0, 1000.0))
    assert folder.is_evaluated(run, 4)
    assert not folder.is_evaluated(run, 5)
    assert folder.is_evaluated(run, 0)


def test_runs_with_other_settings_than_the_printed_command_are_named(tmp_path):
    folder, grid = planned(tmp_path, seeds=2)
    for run in grid.runs:
        leave(folder, run, 1000.0)
    file = folder.run(grid.runs[0]) / "config.json"
    facts = json.loads(file.read_text())
    facts["config"]["rollout"]["num_envs"] = 77
    file.write_text(json.dumps(facts))
    results, page = report_of(folder)
    assert results["run_otherwise"] == {grid.runs[0].name: ["--num-envs was 77"]}
    assert "These commands do not give these runs again" in page


def test_a_run_without_any_episode_is_named(tmp_path):
    folder, grid = planned(tmp_path, seeds=1)
    for run in grid.runs:
        leave(folder, run, 1000.0)
    (folder.run(grid.runs[0]) / "episodes.jsonl").write_text("")
    results, page = report_of(folder)
    assert results["runs"]["without_episodes"] == [grid.runs[0].name]
    assert f"Left out, since no training episode has finished: {grid.runs[0].name}." in page
