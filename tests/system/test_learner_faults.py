"""The learner dies between two lines of its loop, or stops: the same bits, nobody is blamed."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import termios

import pytest

from learner.local import free_address
from tests.support import SMALL, checkpoints, iterations, result, wait_until

pytestmark = pytest.mark.slow
ITERATIONS = 20
RUN = (
    "--env", "Hopper-v5", *SMALL, "--total-timesteps", str(ITERATIONS * 8 * 64),
    "--checkpoint-every", "3",
)  # fmt: skip
PLACES = {
    "all rollouts received, none merged": "Chief._collect return 8",
    "gradients received, no step made": "Chief._apply call 30",
    "step made, not broadcast": "Chief._apply return 30",
    "step broadcast to one worker of two": "Questions.ask return 61",
    "KL adapted, iteration not finished": "Chief._adapt return 8",
    "iteration finished, not logged": "Chief.iterate return 8",
    "checkpoint begun": "Saving.begin return 3",
}


@pytest.mark.parametrize("place", PLACES)
def test_a_learner_killed_between_two_lines_goes_on_with_the_same_bits(
    harness, undisturbed, place
):
    run_dir = harness.folder / "run"
    command = (*RUN, "--local-workers", "2")
    learner = harness.start(
        "tests.trapped_learner", *command, "--run-dir", str(run_dir),
        environment={"DPPO_TRAP": PLACES[place]},
    )  # fmt: skip
    assert learner.wait() == -signal.SIGKILL, learner.text
    assert len(checkpoints(run_dir)) >= 1
    assert iterations(run_dir) < ITERATIONS
    outcome = harness.train(*command, run_dir=run_dir)
    assert outcome["restarts"] == 1
    assert outcome["parameters_sha256"] == undisturbed
    rows = [json.loads(line) for line in (run_dir / "metrics.jsonl").read_text().splitlines()]
    assert [row["iteration"] for row in rows] == list(range(1, ITERATIONS + 1))


def test_a_learner_killed_after_the_last_checkpoint_only_has_to_say_so(harness, undisturbed):
    """Its external workers were told that the run is over: nobody comes back."""
    run_dir = harness.folder / "run"
    harness.train(*RUN, "--local-workers", "2", run_dir=run_dir)
    (run_dir / "result.json").unlink()
    outcome = harness.train(*RUN, "--local-workers", "0", run_dir=run_dir)
    assert outcome["status"] == "finished"
    assert outcome["parameters_sha256"] == undisturbed
    assert outcome["restarts"] == 1
    assert iterations(run_dir) == ITERATIONS


def test_workers_that_a_killed_learner_could_not_tell_hear_the_end_from_the_next_one(
    harness, undisturbed
):
    run_dir, address = harness.folder / "run", free_address()
    command = (*RUN, "--local-workers", "1", "--listen", address)
    learner = harness.start(
        "tests.trapped_learner", *command, "--run-dir", str(run_dir),
        environment={"DPPO_TRAP": "Exchange.stop call 1"},
    )  # fmt: skip
    worker = harness.worker(address)
    assert learner.wait() == -signal.SIGKILL, learner.text
    assert iterations(run_dir) == ITERATIONS
    assert not (run_dir / "result.json").exists()
    outcome = harness.train(*command, run_dir=run_dir)
    assert outcome["parameters_sha256"] == undisturbed
    assert worker.wait() == 0, worker.text


def test_a_run_that_is_not_exact_says_so_after_a_restart_too(harness):
    """A move of an environment that is not made exactly, then a pause."""
    run_dir, address = harness.folder / "run", free_address()
    run = ("--env", "Hopper-v5", *SMALL, "--no-exact-envs", "--total-timesteps", str(10**6))
    here = ("--listen", address, "--local-workers", "1", "--verbose")
    learner = harness.learner(*run, *here, run_dir=run_dir)
    wait_until(lambda: iterations(run_dir) >= 2, "the first iterations")
    harness.worker(address)
    wait_until(lambda: "joined, 2 in the run" in learner.text, "another worker to join")
    last = iterations(run_dir)
    wait_until(lambda: iterations(run_dir) >= last + 3, "it to have slots")
    learner.send(signal.SIGTERM)
    assert learner.wait() == 0, learner.text
    before = result(run_dir)
    assert not before["exact"], "no slot was moved"
    until = str(before["env_steps"] + 2 * 8 * 64)
    after = harness.train(*run, "--local-workers", "8", "--stop-at", until, run_dir=run_dir)
    assert after["env_steps"] > before["env_steps"]
    assert not after["exact"]


def fill(pipe):
    """Until it takes no byte more; who writes waits from then on."""
    os.set_blocking(pipe, False)
    with contextlib.suppress(BlockingIOError):
        while os.write(pipe, b"x" * 4096):
            pass
    os.set_blocking(pipe, True)


def test_a_terminal_that_was_stopped_stops_neither_the_run_nor_its_end(harness):
    """As after Ctrl-S: what is printed waits in the kernel for somebody."""
    run_dir, (reading, writing) = harness.folder / "run", os.openpty()
    words = [sys.executable, "-m", "learner", *RUN, "--total-timesteps", str(10**6 * 8 * 64),
             "--local-workers", "1", "--run-dir", run_dir]  # fmt: skip
    termios.tcflow(writing, termios.TCOOFF)
    learner = subprocess.Popen(words, stdout=writing, stderr=subprocess.PIPE)
    os.close(writing)
    wait_until(lambda: iterations(run_dir) >= 20, "iterations")
    learner.send_signal(signal.SIGTERM)
    _, errors = learner.communicate(timeout=30)
    os.close(reading)
    assert learner.returncode == 0, errors
    assert result(run_dir)["status"] == "stopped"


@pytest.mark.parametrize(
    "way", ["a pipe that nobody reads", "a full pipe", "a full disk", "ascii"]
)
def test_output_that_nobody_takes_costs_no_bit(harness, undisturbed, way):
    run_dir = harness.folder / "run"
    words = [sys.executable, "-m", "learner", *RUN, "--local-workers", "2", "--run-dir", run_dir]
    environment = os.environ | ({"PYTHONIOENCODING": "ascii"} if way == "ascii" else {})
    reading, writing = os.pipe()
    if way == "a full disk":
        os.close(writing)
        writing = os.open("/dev/full", os.O_WRONLY)
    if way == "a full pipe":
        fill(writing)
    elif way != "ascii":
        os.close(reading)
    learner = subprocess.Popen(words, stdout=writing, stderr=subprocess.PIPE, env=environment)
    os.close(writing)
    if way == "ascii":
        with os.fdopen(reading) as output:
            assert "? " in output.read()  # ψ and σ
    _, errors = learner.communicate(timeout=120)
    assert learner.returncode == 0, errors
    assert b"Traceback" not in errors
    assert result(run_dir)["parameters_sha256"] == undisturbed


def test_a_learner_stopped_for_longer_than_any_patience_gives_nobody_up(harness):
    """Its external workers lose it after 2 s and find it again; none of them was to blame."""
    address, run_dir = free_address(), harness.folder / "run"
    steps = ("--total-timesteps", str(200 * 8 * 64))
    workers = [harness.worker(address), harness.worker(address)]
    learner = harness.learner(
        *RUN, *steps, "--local-workers", "0", "--listen", address, "--patience", "1", "--verbose",
        run_dir=run_dir,
    )  # fmt: skip
    wait_until(lambda: iterations(run_dir) >= 3, "three iterations")
    learner.send(signal.SIGSTOP)
    waits = "waiting for a learner's Welcome, for 1"  # ten seconds and more
    wait_until(lambda: all(waits in worker.text for worker in workers), "both to say they wait")
    learner.send(signal.SIGCONT)
    assert learner.wait() == 0, learner.text
    assert [worker.wait() for worker in workers] == [0, 0]
    assert "stalls" not in learner.text
    quiet = harness.train(*RUN, *steps, "--local-workers", "2", run_dir=harness.folder / "quiet")
    assert result(run_dir)["parameters_sha256"] == quiet["parameters_sha256"]
