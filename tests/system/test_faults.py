"""What dies comes back, and costs time, never bits."""

import json
import os
import re
import signal
import time

import pytest

from learner.local import free_address
from tests.support import (
    SMALL,
    checkpoints,
    descendants,
    is_alive,
    iterations,
    result,
    state_of,
    wait_until,
)

pytestmark = pytest.mark.slow
RUN = ("--env", "Hopper-v5", *SMALL, "--total-timesteps", str(100 * 8 * 64))
EVERY = ("--checkpoint-every", "2")
GRACE = 10.0
"""What container engines leave between SIGTERM and SIGKILL [s]: part of the promise."""
PATIENCE = 3.0
"""The learner's own [s]."""


def test_a_worker_started_before_the_learner_waits_and_joins(harness):
    address, run_dir = free_address(), harness.folder / "run"
    worker = harness.worker(address)
    wait_until(lambda: "waiting for a learner" in worker.text, "the worker to say that it waits")
    learner = harness.learner(*RUN, "--local-workers", "0", "--listen", address, run_dir=run_dir)
    assert learner.wait() == 0, learner.text
    assert worker.wait() == 0, worker.text
    assert "joined run" in worker.text


def test_a_worker_killed_mid_iteration_costs_no_bits(harness, undisturbed):
    address, run_dir = free_address(), harness.folder / "run"
    victim, other = harness.worker(address), harness.worker(address)
    learner = harness.learner(
        *RUN, "--local-workers", "0", "--listen", address, "--verbose", run_dir=run_dir
    )
    wait_until(lambda: iterations(run_dir) >= 3, "three iterations")
    victim.kill()
    assert learner.wait() == 0, learner.text
    assert "left: its connection is gone; 1 in the run" in learner.text
    assert other.wait() == 0
    assert result(run_dir)["parameters_sha256"] == undisturbed


def test_a_local_worker_killed_is_replaced_and_costs_no_bits(harness, undisturbed):
    run_dir = harness.folder / "run"
    learner = harness.learner(*RUN, "--local-workers", "1", run_dir=run_dir)
    wait_until(lambda: iterations(run_dir) >= 3, "three iterations")
    (victim,) = descendants(learner.popen.pid)
    os.kill(victim, signal.SIGKILL)
    assert learner.wait() == 0, learner.text
    assert "starting another" in learner.text
    assert result(run_dir)["parameters_sha256"] == undisturbed


def test_a_stopped_local_worker_is_replaced_and_costs_no_bits(harness, undisturbed):
    run_dir = harness.folder / "run"
    learner = harness.learner(*RUN, "--local-workers", "2", "--verbose", run_dir=run_dir)
    wait_until(lambda: iterations(run_dir) >= 3, "three iterations")
    victim = max(descendants(learner.popen.pid))
    os.kill(victim, signal.SIGSTOP)
    assert learner.wait() == 0, learner.text
    assert re.search(r"stalls: silent for \d", learner.text)
    assert "was given up; starting another in its place" in learner.text
    assert not is_alive(victim)
    assert result(run_dir)["parameters_sha256"] == undisturbed


def test_everything_stopped_for_a_while_and_continued_loses_no_worker(harness, undisturbed):
    """For longer than a worker may be silent: the wait is the fault, it waits for nothing."""
    run_dir = harness.folder / "run"
    learner = harness.learner(
        *RUN, "--local-workers", "2", "--verbose", "--patience", str(PATIENCE), run_dir=run_dir
    )
    wait_until(lambda: iterations(run_dir) >= 3, "three iterations")
    workers = descendants(learner.popen.pid)
    for pid in (learner.popen.pid, *workers):
        os.kill(pid, signal.SIGSTOP)
    wait_until(lambda: state_of(learner.popen.pid) == "T", "the learner to stop")
    until = time.monotonic() + 2 * PATIENCE + 1
    wait_until(lambda: time.monotonic() > until, "some time to pass")
    for pid in (*workers, learner.popen.pid):
        os.kill(pid, signal.SIGCONT)
    assert learner.wait() == 0, learner.text
    assert "stalls" not in learner.text
    assert "starting another" not in learner.text
    assert result(run_dir)["parameters_sha256"] == undisturbed


def test_a_learner_killed_and_started_again_finishes_with_the_same_bits(harness, undisturbed):
    run_dir = harness.folder / "run"
    command = (*RUN, *EVERY, "--local-workers", "2")
    learner = harness.learner(*command, run_dir=run_dir)
    wait_until(lambda: len(checkpoints(run_dir)) >= 2, "two checkpoints")
    workers = descendants(learner.popen.pid)
    learner.kill()
    wait_until(lambda: not any(map(is_alive, workers)), "the local workers to die with it")
    outcome = harness.train(*command, run_dir=run_dir)
    assert outcome["parameters_sha256"] == undisturbed
    assert outcome["restarts"] == 1
    rows = [json.loads(line) for line in (run_dir / "metrics.jsonl").read_text().splitlines()]
    assert [row["iteration"] for row in rows] == list(range(1, 101))


def test_external_workers_outlive_the_learner_and_join_the_next_one(harness, undisturbed):
    address, run_dir = free_address(), harness.folder / "run"
    command = (*RUN, *EVERY, "--local-workers", "0", "--listen", address)
    workers = [harness.worker(address), harness.worker(address)]
    learner = harness.learner(*command, run_dir=run_dir)
    wait_until(lambda: len(checkpoints(run_dir)) >= 2, "two checkpoints")
    learner.kill()
    outcome = harness.train(*command, run_dir=run_dir)
    assert outcome["parameters_sha256"] == undisturbed
    assert [worker.wait() for worker in workers] == [0, 0]


def test_sigterm_leaves_a_checkpoint_and_exit_code_0(harness, undisturbed):
    run_dir = harness.folder / "run"
    command = (*RUN, "--checkpoint-every", "1000", "--local-workers", "2")
    learner = harness.learner(*command, run_dir=run_dir)
    wait_until(lambda: iterations(run_dir) >= 2, "two iterations")
    learner.send(signal.SIGTERM)
    assert learner.wait(GRACE) == 0, learner.text
    assert result(run_dir)["status"] == "stopped"
    assert len(checkpoints(run_dir)) == 1
    assert harness.train(*command, run_dir=run_dir)["parameters_sha256"] == undisturbed


def test_a_second_signal_ends_a_learner_at_once_without_a_checkpoint(harness):
    """Both come while it is stopped: the first cannot end it before the second is there."""
    run_dir = harness.folder / "run"
    command = (*RUN, "--checkpoint-every", "1000", "--local-workers", "2")
    learner = harness.learner(*command, run_dir=run_dir)
    wait_until(lambda: iterations(run_dir) >= 2, "two iterations")
    workers = descendants(learner.popen.pid)
    learner.send(signal.SIGSTOP)
    wait_until(lambda: state_of(learner.popen.pid) == "T", "the learner to stop")
    learner.send(signal.SIGTERM)
    learner.send(signal.SIGINT)  # another one: of one kind, two would be one
    learner.send(signal.SIGCONT)
    assert learner.wait() in (128 + signal.SIGTERM, 128 + signal.SIGINT), learner.text
    assert checkpoints(run_dir) == []
    assert not (run_dir / "result.json").exists()
    wait_until(lambda: not any(map(is_alive, workers)), "its workers to end")


def test_a_stopped_worker_is_given_up_and_rejoins(harness, undisturbed):
    """The other one is killed then: only the one that has come back can finish the run."""
    address, run_dir = free_address(), harness.folder / "run"
    stalled, other = harness.worker(address, "--name", "stalled"), harness.worker(address)
    learner = harness.learner(
        *RUN, "--local-workers", "0", "--listen", address, "--verbose", run_dir=run_dir
    )
    wait_until(lambda: iterations(run_dir) >= 2, "two iterations")
    stalled.send(signal.SIGSTOP)
    left = r"worker stalled-\S+ left: (its connection is gone|it was given up)"
    wait_until(lambda: re.search(left, learner.text) is not None, "the learner to give it up")
    stalled.send(signal.SIGCONT)
    other.kill()
    assert learner.wait() == 0, learner.text
    assert stalled.wait() == 0, stalled.text
    assert len(re.findall(r"worker stalled-\S+ joined", learner.text)) == 2
    assert result(run_dir)["parameters_sha256"] == undisturbed
