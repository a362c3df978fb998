"""The report of an experiment, from folders as runs leave them."""

import json
import re
from typing import Any

import pytest
from scipy import stats

from dppo.experiment.folder import Folder
from dppo.experiment.plan import in_order
from dppo.experiment.report import write_report
from dppo.experiment.table2 import ENVIRONMENTS, table2
from dppo.experiment.verdicts import of_goal, of_interval

PLAIN, SAFE = (1000.0, 1600.0, 3200.0, 4100.0, 5600.0), (7000.0, 7010.0, 7025.0, 7030.0, 7035.0)
SESSION = {
    "command": "dppo experiment table2", "time": "2026-01-01T00:00:00+00:00", "jobs": 2,
    "cores": 2, "processor": "a processor", "system": "a system",
}  # fmt: skip


def planned(tmp_path, envs=("HalfCheetah-v4",), seeds=5, evaluate=4, steps=8192):
    """A folder in which nothing has run yet, and its grid."""
    folder = Folder(tmp_path / "out")
    folder.lock()
    grid = table2(envs=envs, psis=(), seeds=seeds, steps=steps, evaluate=evaluate, settings={})
    folder.add_to_plan(grid, SESSION)
    return folder, grid


def leave(folder, run, score, **evaluation):
    """What a finished run leaves: 300 episodes; the last 200 return `score` on average."""
    path = folder.run(run)
    path.mkdir(parents=True)
    facts = {"config": run.config.to_dict(), "versions": {"mujoco": "4.0.0"}}
    ended = {"status": "finished", "parameters_sha256": "ab", "exact": True, "restarts": 0}
    rows = [
        {"iteration": 1, "time/total_timesteps": 4096, "rollout/ep_rew_mean": 0.0},
        {"iteration": 2, "time/total_timesteps": 8192, "rollout/ep_rew_mean": score},
    ]
    episodes = [
        {"iteration": 1, "returns": [-1000.0] * 100, "lengths": [10] * 100},
        {"iteration": 2, "returns": [score - 1, score + 1] * 100, "lengths": [10] * 200},
    ]
    for name, lines in (("metrics.jsonl", rows), ("episodes.jsonl", episodes)):
        (path / name).write_text("".join(json.dumps(line) + "\n" for line in lines))
    for name, values in (
        ("config.json", facts), ("result.json", ended), ("evaluation.json", evaluation),
    ):  # fmt: skip
        if values:
            (path / name).write_text(json.dumps(values))


def evaluated(spread, score, fell=False):
    """Four free episodes and four from one start, apart by `spread`."""
    return {
        "episodes": [
            {
                "start": start, "return": score + sign * spread, "length": 10,
                "discounted_return": (score + sign * spread) / 2, "terminated": fell,
            }
            for start in ("free", "fixed")
            for sign in (-1, -1, 1, 1)
        ],
        "calibration": {
            "ratio": 1.25, "lambda_ret": 1.0,
            "starts": [{"predicted_std": 3.0, "empirical_std": 3.0},
                       {"predicted_std": 5.0, "empirical_std": 4.0}],
        },
    }  # fmt: skip


def report_of(folder):
    plan = folder.read_plan()
    assert plan is not None
    write_report(folder, plan)
    results = json.loads((folder.path / "results.json").read_text())
    return results, (folder.path / "report.md").read_text()


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """All fifteen runs of HalfCheetah; ψ raises the mean and lowers both spreads. Its report."""
    folder, grid = planned(tmp_path_factory.mktemp("whole"))
    for run in grid.runs:
        score = (PLAIN if run.psi == 0 else SAFE)[run.seed - 1]
        spread = 100.0 if run.psi == 0 else 10.0
        leave(folder, run, score, **evaluated(spread, score, fell=run.psi == 0))
    return folder, *report_of(folder)


def test_table_2_stands_beside_the_papers_with_a_judgement_from_intervals(whole):
    _, results, page = whole
    arms = results["environments"]["HalfCheetah-v4"]["arms"]
    last = arms["psi0"]["training"]["last200"]
    assert last["by_seed"] == list(PLAIN)  # the first 100 episodes are not in it
    assert last["mean"] == 3100
    # deviations -2100 -1500 100 1000 2500: squares sum to 13,920,000; / 4, root
    assert last["std_across_seeds"] == pytest.approx(1865.476, abs=1e-3)
    assert last["iqm"] == pytest.approx((1600 + 3200 + 4100) / 3)
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
    assert "ψ 0.3" in page  # never only the best ψ, nor only the paper's


def test_policies_are_compared_by_nested_resampling(whole):
    _, results, page = whole
    arms = results["environments"]["HalfCheetah-v4"]["arms"]
    for start in ("free", "fixed"):
        plain, safe = (arms[arm]["evaluation"][start] for arm in ("psi0", "psi-paper"))
        # ± 100 twice each: a sample's standard deviation is √(4 x 100² / 3)
        assert plain["undiscounted"]["std"] == pytest.approx(115.470, abs=1e-3)
        assert plain["discounted"]["std"] == pytest.approx(57.735, abs=1e-3)
        assert safe["undiscounted"]["cvar10"] == pytest.approx(7020 - 10)
        assert plain["undiscounted"]["worst"] == 900
        assert (plain["falls"], safe["falls"]) == (1.0, 0.0)
        found = arms["psi-paper"]["against_baseline"][start]
        assert found["std_difference"] == pytest.approx(-103.923, abs=1e-3)
        assert found["std_difference_interval"][1] < 0
    assert "Within a policy: evaluation from one fixed start state" in page
    assert "| 100.0% [100.0%, 100.0%] |" in page
    assert "spread lower; mean higher | yes |" in page
    assert "discounted std" in page


def test_the_calibration_is_a_mean_over_seeds(whole):
    _, results, page = whole
    found = results["environments"]["HalfCheetah-v4"]["arms"]["psi0"]["calibration"]
    assert found["ratio"]["mean"] == 1.25
    assert found["predicted_std"]["mean"] == pytest.approx(17**0.5)  # (3² + 5²) / 2
    assert found["empirical_std"]["mean"] == pytest.approx(12.5**0.5)
    assert "Calibration of σ" in page


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
    assert "Calibration" not in page


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
    for column in ("falls", "discounted", "fixed"):
        assert column not in table.splitlines()[2]
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


def against(std, mean):
    """A comparison with these ratios, each with a tenth to both sides."""
    found: dict[str, Any] = {}
    for name, ratio in (("std", std), ("mean", mean)):
        found |= {f"{name}_ratio": ratio, f"{name}_ratio_interval": [ratio - 0.1, ratio + 0.1]}
    return {"free": found}


@pytest.mark.parametrize(
    ("std", "mean", "sentence"),
    [(0.5, 1.1, "yes"), (0.65, 1.1, "the estimate only, not the intervals"),
     (0.5, 1.0, "the estimate only, not the intervals"), (0.8, 1.1, "no"), (0.5, 0.9, "no")],
)  # fmt: skip
def test_a_goal_is_reached_when_both_intervals_are_beyond_it(std, mean, sentence):
    assert of_goal(against(std, mean), "free") == sentence


def test_a_claim_about_all_environments_takes_all_of_them(tmp_path):
    folder, grid = planned(tmp_path, envs=ENVIRONMENTS, seeds=3)
    for run in grid.runs:
        leave(folder, run, 1000 * run.psi + 10.0 * run.seed)
    _, page = report_of(folder)
    assert "| mean higher in 4 of 4 (HalfCheetah-v4, Hopper-v4, Ant-v4, Walker2d-v4)" in page
    assert page.count("| Holds here. |") == 2
    assert "The claim does not hold here: higher." in page  # the paper's Walker has a lower mean


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
