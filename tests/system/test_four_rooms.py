"""`dppo four-rooms` as a person runs it."""

import json
import re
import signal

import pytest

from tests.support import descendants, is_alive, wait_until
from tests.system.test_bad_input import refuses

pytestmark = pytest.mark.slow
PNG = b"\x89PNG\r\n\x1a\n"


def experiment(harness, *args):
    """A running experiment, and its folder."""
    folder = harness.folder / "out"
    return harness.start("dppo", "four-rooms", "--out", str(folder), *args), folder


def finished(harness, *args):
    """The results of an experiment that ran to its end."""
    process, folder = experiment(harness, *args)
    assert process.wait(600) == 0, process.text
    return json.loads((folder / "results.json").read_text()), folder


def test_every_figure_and_the_report_are_written(harness):
    results, folder = finished(
        harness, "--trials", "2", "--episodes", "60", "--psi-sweep", "--ablations", "--jobs", "2"
    )
    pictures = {
        "map.png", "learning_curves.png", "visits.png", "policies.png", "trajectories.png",
        "sweep.png",
    }  # fmt: skip
    assert {path.name for path in folder.iterdir()} == pictures | {"results.json", "report.md"}
    assert all((folder / name).read_bytes().startswith(PNG) for name in pictures)
    page = (folder / "report.md").read_text()
    assert set(re.findall(r"\]\((\w+\.png)\)", page)) == pictures
    for word in ("Equal α_c", "As printed", "Of these ψ", "Expected SARSA"):
        assert word in page
    assert len(results["arms"]) == 19
    assert results["status"] == "finished"
    assert {"psi", "return_mean", "return_std_across_trials", "return_std_within",
            "frozen_steps_per_episode", "timeouts_fraction", "exact_value_mean",
            "exact_sigma_mean", "intervals_95"} <= set(results["arms"][0])  # fmt: skip
    assert results["config"]["seed"] == 0
    assert {"numpy", "matplotlib", "python", "dppo"} == set(results["versions"])


def test_the_default_command_shows_the_claim(harness):
    results, _ = finished(harness)
    plain, safe = results["arms"]
    assert (plain["psi"], safe["psi"]) == (0.0, 0.25)
    assert results["config"]["trials"] == 50
    assert results["config"]["episodes"] == 4000
    # with the ends of the 95 % intervals; for half the spread 50 trials are too few
    intervals = results["comparison"]["intervals_95"]
    assert intervals["return_difference"][0] > 0
    assert intervals["return_std_ratio"][1] < 1
    assert results["comparison"]["return_std_ratio"] < 0.5
    assert intervals["frozen_steps_ratio"][1] < 0.1


def test_the_number_of_processes_changes_no_number(harness, tmp_path):
    size = ("--trials", "3", "--episodes", "40")
    one, _ = finished(harness, *size, "--jobs", "1")
    two, _ = finished(harness, *size, "--jobs", "2")
    assert one["arms"] == two["arms"]
    assert one["comparison"] == two["comparison"]


def test_an_interrupt_keeps_the_arms_that_have_finished(harness):
    # an α_c of nearly 0 leaves the plain arm at random: it takes far longer than the safe one
    process, folder = experiment(
        harness, "--trials", "2", "--episodes", "800", "--jobs", "2",
        "--plain-alpha-critic", "1e-9",
    )  # fmt: skip
    wait_until(lambda: "safe has finished" in process.text, "the safe arm")
    children = descendants(process.popen.pid)
    assert children
    process.send(signal.SIGINT)
    assert process.wait(60) == 130, process.text
    assert "stopped: 1 of 2 arms had finished and are kept" in process.text
    assert "Traceback" not in process.text
    wait_until(lambda: not any(map(is_alive, children)), "its processes to end")
    results = json.loads((folder / "results.json").read_text())
    assert results["status"] == "stopped"
    assert [arm["key"] for arm in results["arms"]] == ["safe"]
    assert "unfinished arms are missing" in (folder / "report.md").read_text()


@pytest.mark.parametrize("jobs", ["1", "2"])
def test_an_interrupt_before_that_says_that_nothing_was_kept(harness, jobs):
    process, folder = experiment(harness, "--jobs", jobs)
    wait_until(lambda: "episodes" in process.text, "the first line of progress")
    number = signal.SIGTERM if jobs == "1" else signal.SIGINT
    process.send(number)
    assert process.wait(60) == 128 + number, process.text
    assert "nothing was written" in process.text
    assert "Traceback" not in process.text
    assert list(folder.iterdir()) == []


def test_the_trainer_trains_on_four_rooms_in_every_worker(harness):
    results = harness.train(
        "--env", "FourRooms-v0", "--slots", "2", "--num-envs", "1", "--num-steps", "64",
        "--update-epochs", "1", "--num-minibatches", "2", "--total-timesteps", "512",
        "--local-workers", "2", run_dir=harness.folder / "run",
    )  # fmt: skip
    assert results["status"] == "finished"


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (["--psi", "nan"], ["--psi is nan, expected a finite number"]),
        (["--trials", "0"], ["--trials is 0, expected >= 1"]),
        (["--episodes", "0"], ["--episodes is 0, expected >= 1"]),
        (["--jobs", "-1"], ["--jobs is -1, expected >= 0"]),
        (["--slip", "2"], ["--slip is 2.0, expected 0 .. 1"]),
        (["--temperature", "0"], ["--temperature is 0.0, expected > 0"]),
        (["--update", "best"], ["'best'", "--update", "'printed'"]),
        (["--out", f"{__file__}/out"], ["cannot be written", "give a folder of yours"]),
    ],
    ids=lambda value: " ".join(value) if isinstance(value[0], str) else None,
)
def test_it_refuses(harness, args, words):
    refuses(harness.start("dppo", "four-rooms", *args), *words)
