"""Folders of experiments as their runs leave them."""

import json

from dppo.experiment.folder import Folder
from dppo.experiment.report import write_report
from dppo.experiment.table2 import table2

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
        "settings": {"action_std": spread / 1000},
        "episodes": [
            {
                "start": start, "return": score + sign * spread, "length": 10,
                "discounted_return": (score + sign * spread) / 2, "terminated": fell,
            }
            for start in ("free", "fixed")
            for sign in (-1, -1, 1, 1)
        ],
        "calibration": {
            "ratio": score / 4000, "along_ratio": 1.25, "along_squares_ratio": 1.1,
            "lambda_ret": 1.0,
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


def whole_grid(path):
    """All fifteen runs of HalfCheetah; ψ raises the mean and lowers both spreads. Its report."""
    folder, grid = planned(path)
    for run in grid.runs:
        score = (PLAIN if run.psi == 0 else SAFE)[run.seed - 1]
        spread = (100.0 if run.psi == 0 else 10.0) + run.seed
        leave(folder, run, score, **evaluated(spread, score, fell=run.psi == 0))
    return folder, *report_of(folder)
