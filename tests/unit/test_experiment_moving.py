"""Arms whose ψ moves: by a limit, or on a schedule."""

import json

import pytest

from dppo.experiment.folder import Folder
from dppo.experiment.grid_file import read_grid
from dppo.experiment.keep import keep
from tests.experiment_folders import SESSION, leave, report_of

GRID = """
environments = ["Hopper-v4"]
seeds = 2
steps = 8192
evaluate = 0
[arms.plain]
psi = 0
[arms.limited]
psi = 0.1
variance-limit = 400
[arms.later]
psi = 0.5
psi-schedule = "linear"
[arms.trvo]
reward-variance = 0.02
"""


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    path = tmp_path_factory.mktemp("moving")
    (path / "grid.toml").write_text(GRID)
    grid, folder = read_grid(path / "grid.toml"), Folder(path / "out")
    folder.lock()
    folder.add_to_plan(grid, SESSION)
    for run in grid.runs:
        leave(folder, run, 1000.0)
        rows = [
            {"time/total_timesteps": 400 * (n + 1), "rollout/ep_rew_mean": 1.0,
             "safety/psi": n / 100, "safety/start_sigma": 100.0 * run.seed + n}
            for n in range(20)
        ]  # fmt: skip
        del rows[19]["safety/start_sigma"]  # no episode began in the last iteration
        text = "".join(json.dumps(row) + "\n" for row in rows)
        (folder.run(run) / "metrics.jsonl").write_text(text)
    return folder, *report_of(folder)


def test_labels_do_not_name_a_psi_that_is_not_there(found):
    _, results, _ = found
    arms = results["environments"]["Hopper-v4"]["arms"]
    assert [arm["label"] for arm in arms.values()] == [
        "plain (ψ 0)", "limited (σ(s_0) ≤ 400)", "later (ψ 0 to 0.5, linear)", "trvo (ψ 0, κ 0.02)"
    ]  # fmt: skip
    assert [arm["is_plain"] for arm in arms.values()] == [True, False, False, False]


def test_what_psi_came_to_is_told_and_whether_the_limit_was_kept(found):
    """Of 19 values of σ(s_0) the last two: 117 and 118 with seed 1, 217 and 218 with 2."""
    _, results, page = found
    arms = results["environments"]["Hopper-v4"]["arms"]
    assert arms["limited"]["moved"]["psi"]["by_seed"] == [0.19, 0.19]
    assert arms["limited"]["moved"]["start_sigma"]["by_seed"] == [117.5, 217.5]
    assert arms["plain"]["moved"] == arms["trvo"]["moved"] == {}
    table = page.split("## Where ψ moves")[1].split("##")[0]
    line = "2 | 0.19 (seeds: 0.19 to 0.19) | 168 (seeds: 118 to 218) |"
    assert f"| Hopper-v4 | limited (σ(s_0) ≤ 400) | {line}" in table
    assert f"| Hopper-v4 | later (ψ 0 to 0.5, linear) | {line}" in table
    assert "plain" not in table


def test_curves_name_no_psi_where_it_moves(found):
    folder, _, _ = found
    rows = (folder.path / "curves.csv").read_text().splitlines()
    assert {tuple(row.split(",")[1:3]) for row in rows[1:]} == {
        ("plain", "0"), ("limited", ""), ("later", ""), ("trvo", "0")
    }  # fmt: skip


def test_it_is_kept(found, tmp_path):
    folder, _, page = found
    keep(folder, folder.read_plan(), tmp_path / "kept")
    assert (tmp_path / "kept" / "report.md").read_text() == page
