"""Workers come, go, crawl and crowd: how many there are, and how fast, costs no bits."""

import os
import signal
import socket
from pathlib import Path

import pytest

from learner.local import free_address
from tests.support import DEADLINE, SMALL, descendants, iterations, result, wait_until

pytestmark = pytest.mark.slow
RUN = (
    "--env", "tests.odd_envs:Walk-v0", *SMALL, "--total-timesteps", str(150 * 8 * 64), "--verbose",
)  # fmt: skip
OPENING_SECONDS = 10.0
"""What it takes Zenoh to give up a session that nobody answers."""


def external(address):
    return ("--local-workers", "0", "--listen", address)


def test_a_worker_that_joins_in_the_middle_of_an_iteration_costs_no_bits(harness, undisturbed):
    """It is ready while the others are asked, and gets slots in the next iteration."""
    address, run_dir = free_address(), harness.folder / "run"
    first = harness.worker(address)
    learner = harness.learner(*RUN, *external(address), run_dir=run_dir)
    wait_until(lambda: iterations(run_dir) >= 3, "three iterations")
    second = harness.worker(address)
    wait_until(lambda: "joined, 2 in the run" in learner.text, "the second one to join")
    last = iterations(run_dir)
    wait_until(lambda: iterations(run_dir) >= last + 3, "it to have slots")
    first.kill()  # now the run hangs on the one that has joined
    assert learner.wait() == 0, learner.text
    assert second.wait() == 0
    assert result(run_dir)["parameters_sha256"] == undisturbed


def test_all_workers_leave_and_others_come_later(harness, undisturbed):
    """While nobody is there the learner waits, and says for what."""
    address, run_dir = free_address(), harness.folder / "run"
    workers = [harness.worker(address), harness.worker(address)]
    learner = harness.learner(*RUN, *external(address), run_dir=run_dir)
    wait_until(lambda: iterations(run_dir) >= 3, "three iterations")
    for worker in workers:
        worker.send(signal.SIGTERM)
    assert [worker.wait() for worker in workers] == [0, 0]
    wait_until(lambda: "waiting for any worker, for slots" in learner.text, "it to say so")
    assert "0 in the run" in learner.text
    harness.worker(address)
    assert learner.wait() == 0, learner.text
    assert result(run_dir)["parameters_sha256"] == undisturbed


def test_with_fewer_workers_than_w_minus_d_slots_move_together(harness):
    """W - D concerns slots: the one worker that is left runs all of them."""
    run_dir = harness.folder / "run"
    learner = harness.learner(*RUN, "--drop", "1", "--local-workers", "1", run_dir=run_dir)
    assert learner.wait() == 0, learner.text
    assert result(run_dir)["status"] == "finished"
    assert result(run_dir)["dropped_gradients"] == 0


def test_a_worker_that_crawls_for_ever_costs_no_bits_and_stands_by(harness, undisturbed):
    """It takes 5 ms a step, the others a hundredth of that: they are done sooner without it."""
    address, run_dir = free_address(), harness.folder / "run"
    slow = harness.start(
        "workers", "--connect", address, "--name", "slow",
        environment={"ODD_SECONDS_PER_STEP": "0.005"},
    )  # fmt: skip
    learner = harness.learner(*RUN, *external(address), run_dir=run_dir)
    wait_until(lambda: " joined, 1 in the run" in learner.text, "the slow one to join")
    harness.worker(address, "--name", "quick")
    assert learner.wait() == 0, learner.text
    assert slow.wait() == 0, slow.text
    assert "the others are done sooner without them: worker slow-" in learner.text
    assert "stalls" not in learner.text
    assert result(run_dir)["parameters_sha256"] == undisturbed


def test_eight_workers_on_fewer_cores_cost_no_bits(harness, undisturbed):
    """However many cores there are: all processes of the run share two."""
    run_dir = harness.folder / "run"
    learner = harness.learner(*RUN, "--local-workers", "8", run_dir=run_dir)
    everybody = [learner.popen.pid]
    wait_until(lambda: len(descendants(learner.popen.pid)) == 8, "eight workers")
    everybody += descendants(learner.popen.pid)
    for pid in everybody:
        os.sched_setaffinity(pid, sorted(os.sched_getaffinity(0))[:2])
    assert learner.wait() == 0, learner.text
    assert "stalls" not in learner.text
    assert "starting another" not in learner.text
    assert result(run_dir)["parameters_sha256"] == undisturbed


def test_nothing_of_a_run_lies_in_dev_shm(harness):
    """A container's is 64 MB: memory that is shared has no name there."""
    run_dir = harness.folder / "run"
    learner = harness.learner(*RUN, "--local-workers", "2", run_dir=run_dir)
    wait_until(lambda: " joined, 2 in the run" in learner.text, "both workers to join")
    pids = [learner.popen.pid, *descendants(learner.popen.pid)]
    maps = {pid: Path(f"/proc/{pid}/maps").read_text() for pid in pids}
    assert len(maps) == 3
    assert all("/memfd:" in text for text in maps.values())
    assert [pid for pid, text in maps.items() if "/dev/shm" in text] == []
    assert learner.wait() == 0, learner.text


def test_a_worker_whose_learner_has_no_name_yet_waits_for_it(harness):
    """As in a cluster that starts everything at once: the name resolves later, or never."""
    worker = harness.worker("tcp/not-there-yet.invalid:7447", "--wait-seconds", "3")
    wait_until(lambda: "waiting for a learner at tcp/not-there-yet" in worker.text, "it to say so")
    assert worker.popen.poll() is None
    assert worker.wait() == 2, worker.text
    assert "no learner answered at tcp/not-there-yet.invalid:7447 for 3 s" in worker.text


def test_a_run_over_ipv6_alone_has_the_same_bits(harness, undisturbed):
    port = free_address().rpartition(":")[2]
    address, run_dir = f"tcp/[::1]:{port}", harness.folder / "run"
    worker = harness.worker(address)
    learner = harness.learner(*RUN, *external(address), run_dir=run_dir)
    assert learner.wait() == 0, learner.text
    assert worker.wait() == 0, worker.text
    assert result(run_dir)["parameters_sha256"] == undisturbed


def test_a_worker_ends_at_once_though_somebody_takes_its_connection_and_never_answers(harness):
    with socket.create_server(("127.0.0.1", 0)) as mute:
        worker = harness.worker(f"tcp/127.0.0.1:{mute.getsockname()[1]}")
        mute.settimeout(DEADLINE)
        taken, _ = mute.accept()  # it is in the middle of opening its session now
        with taken:
            worker.send(signal.SIGTERM)
            assert worker.wait(OPENING_SECONDS - 1) == 0, worker.text
