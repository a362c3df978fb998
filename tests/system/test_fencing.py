"""One learner per run and folder, one name per worker, whatever is copied, stopped or stale."""

import os
import shutil
import signal

import pytest

from dppo.wire.messages import Hello
from dppo.wire.zenoh_links import ZenohWorkerLink, open_connecting
from learner.local import free_address
from tests.support import (
    SMALL,
    checkpoints,
    iterations,
    result,
    state_of,
    wait_until,
)

pytestmark = pytest.mark.slow
STEPS = 100 * 8 * 64
RUN = ("--env", "Hopper-v5", *SMALL, "--total-timesteps", str(STEPS), "--checkpoint-every", "2")
ENDLESS = ("--env", "Hopper-v5", *SMALL, "--total-timesteps", "100000000")
SEED_1 = ("--seed", "1")


def external(address):
    return ("--local-workers", "0", "--listen", address)


def refused(process, *words):
    """The process ended with code 2 and one sentence that has these words."""
    assert process.wait() == 2, process.text
    assert "Traceback" not in process.text
    for word in words:
        assert word in process.text, process.text


@pytest.mark.parametrize("stopped", [False, True], ids=["at work", "stopped"])
def test_a_second_learner_on_the_folder_or_the_address_is_refused(harness, stopped):
    address, run_dir = free_address(), harness.folder / "run"
    first = harness.learner(*ENDLESS, "--local-workers", "1", "--listen", address, run_dir=run_dir)
    wait_until(lambda: iterations(run_dir) >= 2, "two iterations")
    if stopped:
        first.send(signal.SIGSTOP)
        wait_until(lambda: state_of(first.popen.pid) == "T", "the learner to stop")
    refused(
        harness.learner(*ENDLESS, run_dir=run_dir),
        f"another learner is at work in --run-dir {run_dir}",
    )
    refused(
        harness.learner(*ENDLESS, *external(address), run_dir=harness.folder / "other"),
        f"cannot listen on {address}",
        "give --listen a free address",
    )
    first.send(signal.SIGCONT)
    first.send(signal.SIGTERM)
    assert first.wait() == 0, first.text


def test_a_learner_that_hears_of_a_later_one_stops_at_once_and_stays_stopped(harness):
    address, run_dir = free_address(), harness.folder / "run"
    command = (
        *ENDLESS, "--checkpoint-every", "100000", "--local-workers", "2", "--listen", address,
    )  # fmt: skip
    learner = harness.learner(*command, run_dir=run_dir)
    wait_until(lambda: iterations(run_dir) >= 3, "three iterations")
    session = open_connecting(address)
    assert session is not None
    link = ZenohWorkerLink(session, "late-3f2a9c")
    run = (run_dir / "run-id").read_text()
    link.send(
        Hello(
            worker="late-3f2a9c", host="lab1", pid=7, numerics="", versions="", served_run=run,
            served_generation=5,
        )
    )  # fmt: skip
    why = f"worker late-3f2a9c on lab1 has served generation 5 of run {run}, this learner is gen"
    what_to_do = f"or, to go on from this one all the same, delete {run_dir / 'superseded'}"
    refused(learner, why, "this folder is an old copy", what_to_do)
    link.close()
    assert checkpoints(run_dir) == []  # a learner that is merely stopped saves one
    assert not (run_dir / "result.json").exists()
    refused(harness.learner(*command, run_dir=run_dir), "an earlier start here found", why)
    (run_dir / "superseded").unlink()
    again = harness.learner(*command, run_dir=run_dir)
    counted = run_dir / "generation"
    wait_until(lambda: counted.read_text() == "6", "a generation above what the worker has served")
    again.send(signal.SIGTERM)
    assert again.wait() == 0, again.text


def test_an_old_copy_of_a_folder_gets_no_worker_of_the_run_that_has_gone_on(harness, undisturbed):
    address, run_dir, copy = free_address(), harness.folder / "run", harness.folder / "copy"
    command = (*RUN, *external(address))
    worker = harness.worker(address)
    first = harness.learner(*command, "--stop-at", str(STEPS // 10), run_dir=run_dir)
    assert first.wait() == 0, first.text
    shutil.copytree(run_dir, copy)
    for part in (2, 3):  # generations 2 and 3 of the run; the copy will be generation 2
        learner = harness.learner(*command, "--stop-at", str(part * STEPS // 10), run_dir=run_dir)
        assert learner.wait() == 0, learner.text
    before = checkpoints(copy)
    refused(
        harness.learner(*command, run_dir=copy),
        "has served generation 3 of run",
        "this learner is generation 2: either another learner has gone on with the run",
    )
    assert checkpoints(copy) == before
    last = harness.learner(*command, run_dir=run_dir)
    assert last.wait() == 0, last.text
    assert worker.wait() == 0, worker.text
    assert "joined run copy" not in worker.text
    assert result(run_dir)["parameters_sha256"] == undisturbed


def test_a_learner_whose_folder_counts_a_later_one_writes_no_more(harness):
    """As on a network file system without locks: a second one was started on the same folder."""
    run_dir = harness.folder / "run"
    learner = harness.learner(
        *ENDLESS, "--checkpoint-every", "2", "--local-workers", "1", run_dir=run_dir
    )
    wait_until(lambda: len(checkpoints(run_dir)) >= 2, "two checkpoints")
    (run_dir / "generation").write_text("2")
    refused(learner, "another learner, generation 2, was started in", "only one learner runs")
    assert not (run_dir / "superseded").exists()
    assert not (run_dir / "result.json").exists()


def test_an_older_checkpoint_put_back_is_a_new_generation_that_workers_join(harness, undisturbed):
    address, run_dir = free_address(), harness.folder / "run"
    command = (*RUN, *external(address))
    worker = harness.worker(address)
    first = harness.learner(*command, "--stop-at", str(STEPS // 2), run_dir=run_dir)
    assert first.wait() == 0, first.text
    newest = run_dir / "checkpoints" / checkpoints(run_dir)[-1]
    shutil.rmtree(newest)
    (run_dir / "generation").write_text("")  # damaged as well: the checkpoints know it
    outcome = harness.train(*command, run_dir=run_dir)
    assert worker.wait() == 0, worker.text
    assert "joined run run (generation 2)" in worker.text
    assert outcome["restarts"] == 1
    assert outcome["parameters_sha256"] == undisturbed


def test_a_worker_goes_over_to_another_run_at_the_same_address(harness):
    """A colleague's run: it has served generation 2 of ours, theirs is generation 1."""
    address, ours, theirs = free_address(), harness.folder / "ours", harness.folder / "theirs"
    worker = harness.worker(address)
    for part in (1, 2):
        learner = harness.learner(
            *RUN, *external(address), "--stop-at", str(part * STEPS // 10), run_dir=ours
        )
        assert learner.wait() == 0, learner.text
    other = harness.train(*RUN, *SEED_1, *external(address), run_dir=theirs)
    assert worker.wait() == 0, worker.text
    assert "joined run theirs (generation 1)" in worker.text
    alone = harness.train(*RUN, *SEED_1, run_dir=harness.folder / "alone")
    assert other["parameters_sha256"] == alone["parameters_sha256"]


def test_two_workers_started_with_one_name_are_two_workers(harness, undisturbed):
    address, run_dir = free_address(), harness.folder / "run"
    twins = [harness.worker(address, "--name", "lab") for _ in range(2)]
    learner = harness.learner(*RUN, *external(address), "--verbose", run_dir=run_dir)
    assert learner.wait() == 0, learner.text
    assert [twin.wait() for twin in twins] == [0, 0]
    assert "joined, 2 in the run" in learner.text
    names = {line.split("worker ")[1].split()[0] for line in learner.text.splitlines()
             if " joined, " in line}  # fmt: skip
    assert len(names) == 2
    assert all(name.startswith("lab-") for name in names)
    assert result(run_dir)["parameters_sha256"] == undisturbed


def test_a_worker_that_comes_back_while_its_old_self_still_holds_slots(harness, undisturbed):
    """The old process is stopped, its connection lives for two more seconds; the new one joins."""
    address, run_dir = free_address(), harness.folder / "run"
    old = harness.worker(address, "--name", "lab")
    learner = harness.learner(*RUN, *external(address), "--verbose", run_dir=run_dir)
    wait_until(lambda: iterations(run_dir) >= 3, "three iterations")
    old.send(signal.SIGSTOP)
    new = harness.worker(address, "--name", "lab")
    assert learner.wait() == 0, learner.text
    assert new.wait() == 0, new.text
    assert learner.text.count(" joined, ") == 2
    assert "joins anew" not in learner.text  # it is not taken for the old one
    assert result(run_dir)["parameters_sha256"] == undisturbed


def test_workers_that_crash_at_their_start_end_the_run_with_a_sentence(harness):
    """A broken installation: they die as soon as they import gymnasium, again and again."""
    broken = harness.folder / "broken"
    broken.mkdir()
    (broken / "gymnasium.py").write_text("raise ImportError('this installation is broken')\n")
    paths = os.pathsep.join([str(broken), os.environ.get("PYTHONPATH", "")])
    learner = harness.start(
        "learner", *RUN, "--local-workers", "2", "--run-dir", str(harness.folder / "run"),
        environment={"PYTHONPATH": paths},
    )  # fmt: skip
    assert learner.wait() == 1, learner.text
    assert "this installation is broken" in learner.text
    for told in ("local workers died 3 times", "the last with exit code 1; see what they printed"):
        assert told in learner.text, learner.text
