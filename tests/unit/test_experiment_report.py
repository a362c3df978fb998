"""The report of an experiment, from folders as runs leave them."""

import json
import re

import numpy as np
import pytest
from scipy import stats

from dppo.experiment.plan import in_order
from dppo.experiment.table2 import ENVIRONMENTS, table2
from tests.experiment_folders import (
    PLAIN,
    SAFE,
    SESSION,
    evaluated,
    leave,
    planned,
    report_of,
)


def test_table_2_stands_beside_the_papers_with_a_judgement_from_intervals(whole):
    _, results, page = whole
    arms = results["environments"]["HalfCheetah-v4"]["arms"]
    last = arms["psi0"]["training"]["last200"]
    assert last["by_seed"] == list(PLAIN)  # the first 100 episodes are not in it
    assert last["mean"] == 3100
    # deviations -2100 -1500 100 1000 2500: squares sum to 13,920,000; / 4, root
    assert last["std_across_seeds"] == pytest.approx(1865.476, abs=1e-3)
    assert last["iqm"] == pytest.approx((1600 + 3200 + 4100) / 3)
    assert 1000 < last["iqm_interval"][0] < last["iqm"] < last["iqm_interval"][1] < 5600
    each = np.concatenate([[score - 1, score + 1] * 100 for score in PLAIN])
    assert last["std_of_all_episodes"] == pytest.approx(each.std(ddof=1))
    found = arms["psi-paper"]["against_baseline"]["last200"]
    assert found["difference"] == 3920
    assert found["welch_p"] == pytest.approx(stats.ttest_ind(SAFE, PLAIN, equal_var=False).pvalue)
    assert found["brown_forsythe_p"] == pytest.approx(stats.levene(SAFE, PLAIN).pvalue)
    assert found["probability_of_improvement"] == 1.0
    assert (
        "| HalfCheetah-v4 | 0.15 | 3614.3 ± 1424.0 | 3100.0 ± 1865.5 | 4256.0 ± 1002.0 |" in page
    )
    assert "| 20 | 5 / 5 | mean: higher; spread: lower |" in page
    assert "The claim holds here: higher." in page
    assert "The claim holds here: lower." in page
    assert "shown in 1 of 1 environments (HalfCheetah-v4) | Not decided: 1 of the 4" in page
    assert "of 2 comparisons of arms that are equal, up to 0.1 would look different" in page
    assert "of 9 that say nothing true, up to 0.45 would be judged one way" in page
    assert "| HalfCheetah-v4 | ψ 0 | 1000.0 | 1600.0 | 3200.0 | 4100.0 | 5600.0 |" in page
    assert "ψ 0.3" in page  # never only the best ψ, nor only the paper's


def test_pictures_are_inside_the_web_page_and_beside_the_other(whole):
    folder, _, page = whole
    linked = set(re.findall(r"\]\(([^)]+\.png)\)", page))
    assert linked == {"curves-HalfCheetah-v4.png", "policies-HalfCheetah-v4.png"}
    for name in linked:
        assert (folder.path / name).read_bytes().startswith(b"\x89PNG\r\n\x1a\n")
    web = (folder.path / "report.html").read_text()
    assert web.count("<img ") == web.count('src="data:image/png;base64,') == 2
    assert "<script" not in web
    rows = (folder.path / "curves.csv").read_text().splitlines()
    assert rows[1].startswith("HalfCheetah-v4,psi0,0,5,4096,0,0")
    assert rows[200] == "HalfCheetah-v4,psi0,0,5,8192,3100,1865.48"


def test_the_same_folder_gives_the_same_report_to_the_bit(whole):
    folder, results, page = whole
    assert report_of(folder) == (results, page)


def test_a_partial_grid_says_so_and_a_seed_alone_shows_nothing(tmp_path):
    folder, grid = planned(tmp_path)
    first = in_order(grid.runs)[:2]
    for run in first:
        leave(folder, run, 1000.0 + run.psi)
    folder.note_failures({first[0].name: "an old failure", "x": "of no run"}, [])
    folder.note_failures({grid.runs[4].name: "its disk | burnt"}, [grid.runs[4]])
    results, page = report_of(folder)
    assert results["status"] == "partial"
    assert results["runs"]["finished"] == 2
    # evaluations are still to come, so the first failure stands
    assert results["runs"]["failed"][grid.runs[4].name] == "its disk | burnt"
    assert "x" not in results["runs"]["failed"]
    assert "This is a partial grid" in page
    assert "| ψ 0.3 | 0 of 5 |" in page
    assert "one seed shows nothing" in page
    assert "Within a policy" not in page
    assert "Does σ know" not in page


@pytest.mark.slow
def test_a_grid_of_which_only_failed_runs_are_missing_is_over(tmp_path):
    folder, grid = planned(tmp_path, seeds=3)
    for run in grid.runs[1:]:
        leave(folder, run, 1000.0, **evaluated(10.0 + run.seed, 1000.0))
    assert report_of(folder)[0]["status"] == "partial"
    folder.note_failures({grid.runs[0].name: "its disk burnt"}, [grid.runs[0]])
    results, page = report_of(folder)
    assert results["status"] == "over, with failures"
    assert "interim" not in page.lower()
    assert "its disk burnt" in page
    assert "With 2 seeds an arm it can find none." in page  # the fewest of any arm


def test_nothing_finished_is_a_report_as_well(tmp_path):
    folder, _ = planned(tmp_path)
    _, page = report_of(folder)
    assert "0 of 15 runs have finished" in page
    assert "![" not in page


def test_what_an_evaluation_lacks_is_left_out(tmp_path):
    folder, grid = planned(tmp_path, seeds=2)
    for run in grid.runs:
        episodes = [{"start": "free", "return": float(run.seed + n), "length": 5} for n in (1, 2)]
        leave(folder, run, 1000.0, episodes=episodes)
    results, page = report_of(folder)
    table = page.split("## Within a policy")[1].split("##")[0]
    assert "CVaR 10 %" in table
    assert "falls" not in table.splitlines()[2]
    assert "discounted returns from" not in page
    assert "one fixed start state" not in page
    assert (
        "falls"
        not in results["environments"]["HalfCheetah-v4"]["arms"]["psi0"]["evaluation"]["free"]
    )


def test_environments_together_are_in_units_of_their_baselines(tmp_path):
    folder, grid = planned(tmp_path, envs=("Hopper-v4", "Ant-v4"), seeds=4)
    for run in grid.runs:
        unit = 1000.0 if run.env == "Ant-v4" else 10.0
        leave(folder, run, unit * (1 if run.psi == 0 else 2 if run.arm == "psi-paper" else 0.5))
    results, page = report_of(folder)
    found = {arm: one["iqm"] for arm, one in results["over_environments"].items()}
    assert found == pytest.approx({"psi0": 1.0, "psi-paper": 2.0, "psi-twice": 0.5})
    assert "Over all environments" in page
    assert "| psi0 | 4 | 1.00 | 1.00 | – | – | – |" in page  # its own unit: nothing to doubt
    assert "| psi-paper | 4 | 2.00 | 2.00 [2.00, 2.00] |" in page


def test_a_baseline_of_which_little_is_known_is_a_doubtful_unit(tmp_path):
    folder, grid = planned(tmp_path, envs=("Hopper-v4", "Ant-v4"), seeds=4)
    for run in grid.runs:
        leave(folder, run, 100.0 * run.seed if run.psi == 0 else 1000.0)
    results, _ = report_of(folder)
    low, high = results["over_environments"]["psi-paper"]["iqm_interval"]
    assert low < 3.5  # 1000 / 250, and that mean may be anything from 100 to 400
    assert high > 4.5


def test_trained_runs_that_are_to_be_evaluated_are_named(tmp_path):
    folder, grid = planned(tmp_path, seeds=1)
    for run in grid.runs:
        leave(folder, run, 1000.0, **({} if run.psi == 0 else evaluated(10.0, 1000.0)))
    results, page = report_of(folder)
    assert results["status"] == "partial"
    assert results["runs"]["not_evaluated"] == [grid.runs[0].name]
    assert f"Trained, and not evaluated yet: {grid.runs[0].name}." in page


def test_settings_are_those_the_runs_had_not_those_of_today(tmp_path):
    """A default may have changed since."""
    folder, grid = planned(tmp_path, seeds=1)
    for run in grid.runs:
        leave(folder, run, 1000.0)
        file = folder.run(run) / "config.json"
        facts = json.loads(file.read_text())
        facts["config"]["returns"]["gamma"] = 0.995
        file.write_text(json.dumps(facts | {"code": "3f2a"}))
    _, page = report_of(folder)
    assert "gae_lambda 0.95 (paper 0.98)" in page
    assert "gamma 0." not in page
    assert "code 3f2a" in page


def test_no_interval_is_given_in_units_that_may_be_zero(tmp_path):
    folder, grid = planned(tmp_path, envs=("Hopper-v4", "Ant-v4"), seeds=3)
    for run in grid.runs:
        leave(folder, run, {1: -300.0, 2: 100.0, 3: 400.0}[run.seed])
    results, _ = report_of(folder)
    found = results["over_environments"]["psi-paper"]
    assert (found["seeds"], found["iqm_interval"]) == (3, None)


@pytest.mark.slow
def test_a_claim_about_all_environments_takes_all_of_them(tmp_path):
    folder, grid = planned(tmp_path, envs=ENVIRONMENTS, seeds=3, evaluate=0)
    for run in grid.runs:
        leave(folder, run, 1000 * run.psi + 10.0 * run.seed)
    _, page = report_of(folder)
    assert "| mean higher in 4 of 4 (HalfCheetah-v4, Hopper-v4, Ant-v4, Walker2d-v4)" in page
    assert page.count("| Holds here. |") == 2
    assert "Better than the paper reports: higher." in page  # its Walker has a lower mean


def test_returns_on_the_way_are_read_off_the_curves(tmp_path):
    folder, grid = planned(tmp_path, seeds=2, steps=2_000_000)
    rows = [
        {"time/total_timesteps": 500_000, "rollout/ep_rew_mean": 100.0},
        {"time/total_timesteps": 1_500_000, "rollout/ep_rew_mean": 300.0},
    ]
    for run in grid.runs:
        leave(folder, run, 1000.0)
        lines = [row | {"iteration": n} for n, row in enumerate(rows, 1)]
        if run.seed == 2:
            lines[1]["rollout/ep_rew_mean"] = 500.0
        text = "".join(json.dumps(line) + "\n" for line in lines)
        (folder.run(run) / "metrics.jsonl").write_text(text)
    results, page = report_of(folder)
    found = results["environments"]["HalfCheetah-v4"]["arms"]["psi0"]["on_the_way"]
    # half-way between the rows: 200 and 300, whose standard deviation is 100 / √2
    assert found["1000000"]["mean"] == 250
    assert found["1000000"]["std_across_seeds"] == pytest.approx(70.711, abs=1e-3)
    assert list(found) == ["1000000", "2000000"]
    assert "| ψ 0 | 250.0 ± 70.7 |" in page


def test_planning_more_keeps_what_was_planned(tmp_path):
    folder, grid = planned(tmp_path, seeds=1)
    more = table2(
        envs=("HalfCheetah-v4", "Ant-v4"), psis=(), seeds=2, steps=8192, evaluate=4, settings={}
    )
    folder.add_to_plan(more, SESSION)
    folder.add_to_plan(grid, SESSION)
    plan = folder.read_plan()
    assert plan is not None
    runs = {run.name: run for run in plan.grid.runs}
    assert runs == {run.name: run for run in more.runs}
    assert len(plan.sessions) == 3
