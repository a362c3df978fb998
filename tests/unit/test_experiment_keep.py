"""What is kept of an experiment says all that the whole folder says."""

import json
from dataclasses import replace

import numpy as np
import pytest

from dppo.errors import UsageError
from dppo.experiment import keep as keeping
from dppo.experiment.best import best_of
from dppo.experiment.folder import Folder
from dppo.experiment.keep import keep
from dppo.experiment.measure import Cell, Finished
from tests.experiment_folders import evaluated, leave, planned, report_of


@pytest.fixture(scope="module")
def kept(whole, tmp_path_factory):
    """What is kept of the whole grid's folder, which has more than a report needs."""
    folder, _, _ = whole  # other tests read it, too: nothing here changes its report
    for run in folder.read_plan().grid.runs:
        with (folder.run(run) / "metrics.jsonl").open("a") as metrics:
            metrics.write(json.dumps({"iteration": 3, "train/kl": 0.1}) + '\n{"torn": ')
        checkpoints = folder.run(run) / "checkpoints"
        for number in (1, 2):
            (checkpoints / f"iteration-0000000{number}").mkdir(parents=True)
            (checkpoints / f"iteration-0000000{number}" / "manifest.json").write_text("{}")
    out = tmp_path_factory.mktemp("kept")
    keep(folder, folder.read_plan(), out)
    return Folder(out)


@pytest.mark.slow
def test_it_gives_the_same_report_to_the_bit(whole, kept):
    folder, _, _ = whole
    report_of(folder)
    names = sorted(path.name for path in folder.path.iterdir() if path.is_file())
    assert {"report.md", "report.html", "results.json", "curves.csv", "plan.json"} <= set(names)
    for _ in ("as it is written", "again, from what is kept"):
        for name in set(names) - {".lock"}:
            assert (kept.path / name).read_bytes() == (folder.path / name).read_bytes()
        report_of(kept)


def test_a_copy_of_it_would_train_nothing_again(kept):
    runs = kept.read_plan().grid.runs
    assert len(runs) == 15
    assert all(kept.is_evaluated(run, 4) for run in runs)


def test_only_what_the_report_needs_and_the_best_policies_are_in_it(kept):
    small = {"config.json", "result.json", "evaluation.json", "metrics.jsonl", "episodes.jsonl"}
    for run in kept.read_plan().grid.runs:
        files = {path.name for path in kept.run(run).iterdir()}
        assert files == small | ({"checkpoints"} if run.seed == 5 else set())
        lines = (kept.run(run) / "episodes.jsonl").read_text().splitlines()
        assert [json.loads(line)["iteration"] for line in lines] == [2]  # 200 of 300 episodes
    found = [str(path.relative_to(kept.path)) for path in kept.path.glob("runs/*/checkpoints/*")]
    assert sorted(found) == [
        f"runs/HalfCheetah-v4__{arm}__s5/checkpoints/iteration-00000002"
        for arm in ("psi-paper", "psi-twice", "psi0")
    ]


def test_a_folder_that_holds_something_is_refused_and_stays(whole, kept):
    folder, _, _ = whole
    with pytest.raises(UsageError, match=r"is not empty; expected a new folder"):
        keep(folder, folder.read_plan(), kept.path)
    (kept.path / "file").write_text("")
    with pytest.raises(UsageError, match="cannot be written"):
        keep(folder, folder.read_plan(), kept.path / "file" / "out")


def test_the_best_seeds_are_told_as_dppo_eval_tells_them(whole):
    _, results, page = whole
    best = results["environments"]["HalfCheetah-v4"]["arms"]["psi-paper"]["best_seed"]
    assert best["run"] == "runs/HalfCheetah-v4__psi-paper__s5"
    assert best["last100"] == 7035
    assert best["free"] == {"mean": 7035.0, "std": pytest.approx(15 * (4 / 3) ** 0.5)}
    row = "`runs/HalfCheetah-v4__psi-paper__s5` | 7035.0 | 7035 ± 17.3205 | 7035 ± 17.3205 |"
    assert row in page
    assert "`dppo eval RUN --which newest --episodes 4 --fixed-start`" in page


def test_the_best_seed_is_that_of_the_last_hundred_episodes(tmp_path):
    _, grid = planned(tmp_path)
    returns = {1: [0.0] * 100 + [10.0] * 100, 2: [20.0] * 100 + [9.0] * 100}
    finished = tuple(
        Finished(
            run=replace(grid.runs[0], seed=seed), returns=np.array(values),
            curve=(np.zeros(0), np.zeros(0)), moved={}, evaluation={}, result={},
            facts={},
        )
        for seed, values in returns.items()
    )  # fmt: skip
    best = best_of(Cell(env="x", arm="y", runs=grid.runs[:1], finished=finished))
    assert best is not None
    assert best.run.seed == 1


def test_a_run_that_is_still_to_be_evaluated_keeps_its_policy(tmp_path):
    folder, grid = planned(tmp_path, seeds=2)
    for run in grid.runs:
        done = {} if (run.psi, run.seed) == (0, 1) else evaluated(10.0, 100.0 * run.seed)
        leave(folder, run, 100.0 * run.seed, **done)
        checkpoint = folder.run(run) / "checkpoints" / "iteration-00000002"
        checkpoint.mkdir(parents=True)
        (checkpoint / "manifest.json").write_text("{}")
    plan = folder.read_plan()
    assert plan is not None
    keep(folder, plan, tmp_path / "kept")
    kept = {path.parents[1].name for path in tmp_path.glob("kept/runs/*/checkpoints/*")}
    assert kept == {run.name for run in grid.runs if run.seed == 2 or run.psi == 0}


@pytest.mark.parametrize("cut", [KeyboardInterrupt, OSError("no space left")])
def test_one_that_is_interrupted_leaves_an_empty_folder_and_can_be_made_again(
    whole, tmp_path, monkeypatch, cut
):
    folder, _, _ = whole
    plan = folder.read_plan()

    def interrupted(*_args):
        raise cut

    monkeypatch.setattr(keeping, "write_report", interrupted)
    with pytest.raises(KeyboardInterrupt if cut is KeyboardInterrupt else UsageError):
        keep(folder, plan, tmp_path / "kept")
    assert list((tmp_path / "kept").iterdir()) == []
    monkeypatch.undo()
    assert keep(folder, plan, tmp_path / "kept").exists()
