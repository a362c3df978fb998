"""`dppo experiment` as a person runs it: killed, stopped, failing in part, and its report."""

import json
import os
import shutil
import signal

import pytest

from dppo.experiment import work
from dppo.store.run_directory import read_config
from tests.support import checkpoints, descendants, is_alive, iterations, result, wait_until
from tests.system.test_bad_input import refuses

pytestmark = pytest.mark.slow
ENV = "InvertedPendulum-v5"
LEARNER = (
    "--slots", "4", "--num-envs", "1", "--num-steps", "64", "--update-epochs", "2",
    "--num-minibatches", "2",
)  # fmt: skip
ITERATIONS = 80
STEPS = ITERATIONS * 4 * 64
NAMES = [f"{ENV}__psi{psi}__s{seed}" for seed in (1, 2) for psi in ("0", "0.1")]


def grid(harness, *args, name="grid", seeds=2, iterations=ITERATIONS):
    """A running experiment of two arms, and its folder."""
    folder = harness.folder / name
    process = harness.start(
        "dppo", "experiment", "table2", "--envs", ENV, "--psis", "0", "0.1",
        "--seeds", str(seeds), "--steps", str(iterations * 4 * 64), "--jobs", "2",
        "--evaluate", "3", "--out", str(folder), *args, "--", *LEARNER,
    )  # fmt: skip
    return process, folder


def hashes(folder):
    return {name: result(folder / "runs" / name)["parameters_sha256"] for name in NAMES}


def logged(folder, name):
    return iterations(folder / "runs" / name)


@pytest.fixture(scope="module")
def unkilled(tmp_path_factory):
    """The folder of the grid when nothing happens to it."""
    from tests.support import Harness

    harness = Harness(tmp_path_factory.mktemp("unkilled"))
    process, folder = grid(harness)
    assert process.wait() == 0, process.text
    return folder


def test_killed_in_the_middle_and_started_again_it_has_the_hashes_of_an_unkilled_one(
    harness, unkilled
):
    process, folder = grid(harness)
    wait_until(lambda: logged(folder, NAMES[2]) > 20, "the second seed to be under way")
    learners = descendants(process.popen.pid)
    family = [*learners, *(child for pid in learners for child in descendants(pid))]
    assert len(learners) >= 1
    process.kill()
    again, _ = grid(harness)  # the orphans may still be saving: they are waited for
    wait_until(lambda: not any(map(is_alive, family)), "the orphaned learners to end")
    assert again.wait() == 0, again.text
    assert hashes(folder) == hashes(unkilled)
    assert f"{NAMES[0]}: training" not in again.text  # it had finished
    restarts = {name: result(folder / "runs" / name)["restarts"] for name in NAMES}
    assert restarts[NAMES[0]] == 0
    assert sum(restarts.values()) >= 1
    ours, theirs = (json.loads((one / "results.json").read_text()) for one in (folder, unkilled))
    for values in (ours, theirs):  # how it was run may differ
        for arm in values["environments"][ENV]["arms"].values():
            arm.pop("restarts")
    assert ours["environments"] == theirs["environments"]
    assert len(ours["sessions"]) == 2


def test_its_report_and_files_hold_what_was_run(unkilled):
    results = json.loads((unkilled / "results.json").read_text())
    assert results["status"] == "whole"
    assert results["runs"] == {
        "planned": 4, "finished": 4, "without_episodes": [], "not_evaluated": [], "failed": {},
        "missing": [],
    }  # fmt: skip
    arms = results["environments"][ENV]["arms"]
    assert list(arms) == ["psi0", "psi0.1"]
    for arm in arms.values():
        assert arm["seeds"] == [1, 2]
        assert arm["exact"]
        assert len(arm["training"]["last200"]["by_seed"]) == 2
        for start in ("free", "fixed"):
            found = arm["evaluation"][start]
            assert found["episodes_per_seed"] == 3
            assert {"discounted", "falls"} <= set(found)
        assert {"start", "along", "predicted_std", "empirical_std"} <= set(arm["calibration"])
    page, web = ((unkilled / name).read_text() for name in ("report.md", "report.html"))
    for word in ("4 of 4 runs", "ψ 0.1", f"--total-timesteps {STEPS}", "mujoco", "--seeds 2"):
        assert word in page
    assert "partial" not in page
    assert web.count("data:image/png;base64,") == 2
    assert 'src="curves' not in web
    rows = (unkilled / "curves.csv").read_text().splitlines()
    assert rows[0] == "env,arm,psi,seeds,env_steps,return_mean,return_std"
    assert len(rows) == 1 + 2 * 200
    for name in NAMES:  # of each run only the last checkpoint, and the best
        assert 1 <= len(checkpoints(unkilled / "runs" / name)) <= 2


def test_a_learner_gets_the_settings_that_the_plan_resolved(unkilled):
    plan = json.loads((unkilled / "plan.json").read_text())
    assert [run["settings"]["psi"] for run in plan["runs"]] == [0.0, 0.0, 0.1, 0.1]
    config = read_config(unkilled / "runs" / NAMES[1] / "config.json")
    assert (config.safety.psi, config.run.seed, config.rollout.slots) == (0.1, 1, 4)


def test_finished_it_trains_nothing_again_and_reports_all_that_was_ever_planned(harness, unkilled):
    folder = harness.folder / "grid"
    folder.symlink_to(unkilled)
    before = hashes(folder)
    process, _ = grid(harness, "--jobs", "1", seeds=1)
    assert process.wait() == 0, process.text
    assert "training" not in process.text
    assert hashes(folder) == before
    assert "1 of" not in process.text  # its own two are all done
    assert "4 of 4 runs" in (folder / "report.md").read_text()


def test_more_episodes_are_played_by_runs_of_earlier_grids_in_the_folder_too(harness, unkilled):
    """Or the report would never be whole again."""
    folder = harness.folder / "grid"
    shutil.copytree(unkilled, folder)
    process, _ = grid(harness, "--evaluate", "5", "--psis", "0", "0.3", seeds=1)
    assert process.wait() == 0, process.text
    results = json.loads((folder / "results.json").read_text())
    assert (results["status"], results["evaluation_episodes"]) == ("whole", 5)
    found = json.loads((folder / "runs" / NAMES[-1] / "evaluation.json").read_text())
    assert len(found["episodes"]) == 10


def test_what_is_kept_of_it_is_small_has_its_best_policies_and_goes_on(harness, unkilled):
    process = harness.start(
        "dppo", "experiment", "keep", str(unkilled), "--out", str(harness.folder / "grid")
    )
    assert process.wait() == 0, process.text
    folder = harness.folder / "grid"
    arms = json.loads((folder / "results.json").read_text())["environments"][ENV]["arms"]
    best = arms["psi0"]["best_seed"]
    words = ("--which", "newest", "--episodes", "3", "--fixed-start", "--json")
    evaluation = harness.start("dppo", "eval", str(folder / best["run"]), *words)
    assert evaluation.wait() == 0, evaluation.text
    summary = json.loads(evaluation.text)["summary"]
    for start in ("free", "fixed"):
        assert best[start] == {
            "mean": summary[start]["return_mean"], "std": summary[start]["return_std"]
        }  # fmt: skip
    again, _ = grid(harness)
    assert again.wait() == 0, again.text
    assert "training" not in again.text
    assert hashes(folder) == hashes(unkilled)


def test_a_folder_with_runs_of_other_settings_is_refused(harness, unkilled):
    (harness.folder / "grid").symlink_to(unkilled)
    process, _ = grid(harness, iterations=ITERATIONS + 1)
    refuses(process, "with other settings", f"--total-timesteps was {STEPS}, is {STEPS + 256}")


def test_an_arm_that_cannot_run_is_reported_and_the_others_finish(harness):
    process, folder = grid(
        harness, "--envs", ENV, "tests.odd_envs:Raises-v0", seeds=1, iterations=10
    )
    assert process.wait() == 1, process.text
    results = json.loads((folder / "results.json").read_text())
    assert results["status"] == "over, with failures"
    assert results["runs"]["finished"] == 2
    failed = results["runs"]["failed"]
    assert len(failed) == 2
    assert "slot" in failed["tests.odd_envs-Raises-v0__psi0__s1"]
    assert process.text.count("it is tried once more") == 2
    page = (folder / "report.md").read_text()
    assert "**Failed runs**" in page
    assert "tests.odd_envs-Raises-v0__psi0.1__s1: " in page
    assert "failed: tests.odd_envs-Raises-v0__psi0__s1" in process.text
    assert "Traceback" not in process.text


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_stops_all_runs_with_their_checkpoints(harness, number):
    process, folder = grid(harness, iterations=5000)
    wait_until(lambda: all(logged(folder, name) > 5 for name in NAMES[:2]), "both to be at it")
    learners = descendants(process.popen.pid)
    assert len(learners) == 2
    process.send(number)
    assert process.wait() == 0, process.text
    assert "is killed" not in process.text  # they have ended by themselves in the time they had
    assert not any(map(is_alive, learners))
    assert "stopped; 0 of 4 runs are finished" in process.text
    for name in NAMES[:2]:
        outcome = result(folder / "runs" / name)
        assert outcome["status"] == "stopped"
        assert checkpoints(folder / "runs" / name)[-1].endswith(f"{outcome['iterations']:08d}")
    page = harness.start("dppo", "experiment", "report", str(folder))
    assert page.wait() == 0, page.text
    assert "0 of 4 runs have finished" in (folder / "report.md").read_text()


def test_learners_that_do_not_end_are_killed_in_time(harness):
    process, folder = grid(harness, iterations=5000)
    wait_until(lambda: all(logged(folder, name) > 5 for name in NAMES[:2]), "both to be at it")
    learners = descendants(process.popen.pid)
    workers = [child for pid in learners for child in descendants(pid)]
    os.kill(learners[0], signal.SIGSTOP)
    process.send(signal.SIGTERM)
    assert process.wait() == 0, process.text
    assert "does not end, and is killed" in process.text
    assert work._LOOK_SECONDS + work._GRACE_SECONDS < 10  # as docs/experiments.md promises
    wait_until(lambda: not any(map(is_alive, [*learners, *workers])), "everything to end")


def test_a_second_experiment_in_the_same_folder_is_refused(harness, unkilled):
    shutil.copytree(unkilled, harness.folder / "grid")
    process, folder = grid(harness, "--envs", "Reacher-v5", iterations=5000)
    wait_until(lambda: logged(folder, "Reacher-v5__psi0__s1") > 0, "the first to be at it")
    second, _ = grid(harness, iterations=5000)
    refuses(second, "another experiment is at work in --out")
    assert process.popen.poll() is None
    process.send(signal.SIGTERM)
    assert process.wait() == 0, process.text
    assert "stopped; 4 of 8 runs are finished" in process.text  # earlier ones count on both sides


def test_a_grid_file_runs(harness):
    file = harness.folder / "small.toml"
    file.write_text(f"""
        title = "Small"
        environments = ["{ENV}"]
        seeds = [7]
        steps = 2560
        evaluate = 0
        [settings]
        slots = 4
        num-envs = 1
        num-steps = 64
        num-minibatches = 2
        [arms.plain]
        [arms.joint]
        psi = 0.2
        adv-norm = "joint"
        hidden-sizes = [16, 16]
        exact-envs = false
    """)
    folder = harness.folder / "out"
    process = harness.start("dppo", "experiment", str(file), "--out", str(folder), "--jobs", "1")
    assert process.wait() == 0, process.text
    config = read_config(folder / "runs" / f"{ENV}__joint__s7" / "config.json")
    assert config.network.hidden_sizes == (16, 16)
    assert not config.rollout.exact_envs
    page = (folder / "report.md").read_text()
    assert "# Small" in page
    assert "joint (ψ 0.2)" in page
    assert "--no-exact-envs" in page


@pytest.mark.parametrize(
    ("args", "words"),
    [
        ([], ["found nothing, expected a grid", "usage: dppo experiment table2"]),
        (
            ["nowhere.toml"],
            ["is not a readable TOML file", "or table2, report or keep"],
        ),
        (["report", "nowhere"], ["nowhere holds no plan.json"]),
        (["keep", "nowhere", "--out", "kept"], ["nowhere holds no plan.json"]),
        (["nowhere.toml", "--", "--psi", "1"], ["only table2 takes learner flags"]),
        (["table2", "--seeds", "0"], ["--seeds is 0, expected >= 1"]),
        (["table2", "--jobs", "-1"], ["--jobs is -1, expected >= 0"]),
        (["table2", "--steps", "1e-3"], ["--steps is 0.001, expected a whole number >= 1"]),
        (["table2", "--psis", "0.1"], ["--psis is (0.1,), expected 0 among them"]),
        (["table2", "--envs", "Swimmer-v5"], ["the paper names no psi; add --psis"]),
        (["table2", "--out", f"{__file__}/out"], ["cannot be written", "give a folder of yours"]),
        (["table2", "--", "--psy", "1"], ["found the setting --psy"]),
        (
            ["table2", "--envs", "InvertedPendulumm-v5", "--psis", "0"],
            ["which Gymnasium does not know; did you mean InvertedPendulum-v5"],
        ),
        (
            ["table2", "--", "--env-kwargs", '{"nosuch": 1}'],
            ['cannot be made with {"nosuch": 1}', "TypeError"],
        ),
    ],
    ids=lambda value: " ".join(value)[-40:],
)
def test_it_refuses(harness, args, words):
    refuses(harness.start("dppo", "experiment", *args), *words)
