"""A disk that is full, read-only, slow or failing under a real run: same bits, every line once."""

import contextlib
import csv
import json
import os
import re
import shutil
import signal
import subprocess

import pytest

from tests.support import SMALL, checkpoints, result, wait_until

pytestmark = pytest.mark.slow
ITERATIONS = 400
RUN = (
    "--env", "CartPole-v1", *SMALL, "--total-timesteps", str(ITERATIONS * 8 * 64),
    "--local-workers", "1", "--checkpoint-every", "5",
)  # fmt: skip
GRACE = 10.0
"""What container engines leave between SIGTERM and SIGKILL [s]: part of the promise."""


def has_every_line_once(run_dir):
    rows = [json.loads(line) for line in (run_dir / "metrics.jsonl").read_text().splitlines()]
    wanted = list(range(1, ITERATIONS + 1))
    assert [row["iteration"] for row in rows] == wanted
    with (run_dir / "progress.csv").open() as file:
        assert [int(row["iteration"]) for row in csv.DictReader(file)] == wanted
    return rows


def mount(*args):
    """Mount something, or skip: only root may, and not in every container."""
    if os.geteuid() != 0:
        pytest.skip("only root can mount a file system")
    done = subprocess.run(["mount", *args], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        pytest.skip(f"nothing can be mounted here: {done.stderr.strip()}")


def unmount(path):
    subprocess.run(["umount", "--lazy", path], check=False)


@pytest.fixture
def small_disk(tmp_path):
    """A file system of 16 MiB of its own."""
    folder = tmp_path / "small"
    folder.mkdir()
    mount("-t", "tmpfs", "-o", "size=16m", "none", str(folder))
    yield folder
    unmount(folder)


def fill(folder):
    """Take all the room that is left."""
    with (folder / "ballast").open("ab", buffering=0) as file, contextlib.suppress(OSError):
        while True:
            file.write(bytes(4096))


@contextlib.contextmanager
def injected(pid, *faults):
    """Faults in the system calls of a running process, as long as this lasts."""
    if shutil.which("strace") is None:
        pytest.skip("strace is not there")
    command = ["strace", "-f", "-p", str(pid), "-o", "/dev/null"]
    for call, fault in faults:
        command += ["-e", f"inject={call}:{fault}"]
    names = ",".join(call for call, _ in faults)
    process = subprocess.Popen(
        [*command, "-e", f"trace={names}"], stderr=subprocess.PIPE, text=True
    )
    assert process.stderr is not None
    said = process.stderr.readline()
    if "attached" not in said:
        process.wait()
        pytest.skip(f"strace cannot attach here: {said.strip()}")
    try:
        yield
    finally:
        process.terminate()
        process.communicate()


def begun(harness, run_dir):
    """A learner that has saved something."""
    learner = harness.learner(*RUN, run_dir=run_dir)
    wait_until(lambda: len(checkpoints(run_dir)) >= 1, "a checkpoint")
    return learner


def finished(learner, run_dir, undisturbed):
    """It ended well, with the same bits and every line once; the lines."""
    assert learner.wait() == 0, learner.text
    assert "Traceback" not in learner.text
    assert result(run_dir)["parameters_sha256"] == undisturbed
    return has_every_line_once(run_dir)


LOGS, CHECKPOINT = "they are kept in memory", "training goes on and tries again at the next"


def says_that_it_cannot_write(learner):
    wait_until(lambda: LOGS in learner.text, f"'{LOGS}'")
    wait_until(lambda: CHECKPOINT in learner.text, f"'{CHECKPOINT}'")
    assert learner.popen.poll() is None, "the run was over too soon: more iterations are needed"


def failure_said(learner, reason):
    return re.search(f"cannot be written: .*{reason}.*; {CHECKPOINT}", learner.text)


def test_a_disk_that_fills_up_and_gets_room_again(harness, small_disk, undisturbed):
    run_dir = small_disk / "run"
    learner = begun(harness, run_dir)
    fill(small_disk)
    says_that_it_cannot_write(learner)
    (small_disk / "ballast").unlink()
    rows = finished(learner, run_dir, undisturbed)
    assert learner.text.count(CHECKPOINT) == 1
    assert failure_said(learner, "No space left on device")
    assert "checkpoints are written again" in learner.text
    assert "the run's logs are written again" in learner.text
    assert max(row["cluster/unsaved_iterations"] for row in rows) > 5
    log = (run_dir / "log.txt").read_text()
    assert CHECKPOINT in log
    assert "checkpoints are written again" in log


def test_a_disk_that_becomes_read_only_and_writable_again(harness, tmp_path, undisturbed):
    run_dir = tmp_path / "run"
    learner = begun(harness, run_dir)
    mount("--bind", str(run_dir), str(run_dir))
    try:
        mount("-o", "remount,bind,ro", str(run_dir))
        says_that_it_cannot_write(learner)
    finally:
        unmount(run_dir)
    finished(learner, run_dir, undisturbed)
    assert failure_said(learner, "Read-only file system")


def test_errors_of_the_disk_in_every_write(harness, tmp_path, undisturbed):
    run_dir = tmp_path / "run"
    learner = begun(harness, run_dir)
    faults = [(call, "error=EIO") for call in ("pwrite64", "fsync", "mkdir", "rename")]
    with injected(learner.popen.pid, *faults):
        says_that_it_cannot_write(learner)
    finished(learner, run_dir, undisturbed)
    assert failure_said(learner, "Input/output error")


def test_a_slow_disk_stops_no_iteration(harness, tmp_path, undisturbed):
    """Each flush takes half a second, five of them a checkpoint: far longer than 5 iterations."""
    run_dir = tmp_path / "run"
    learner = begun(harness, run_dir)
    with injected(learner.popen.pid, ("fsync", "delay_enter=500000")):
        wait_until(lambda: "the disk is slow: the checkpoint" in learner.text, "a warning")
        assert learner.popen.poll() is None
    rows = finished(learner, run_dir, undisturbed)
    assert learner.text.count("the disk is slow") == 1
    assert max(row["cluster/unsaved_iterations"] for row in rows) >= 10


def test_a_disk_that_stays_full_ends_the_run_in_a_sentence_and_no_checkpoint_is_lost(
    harness, small_disk, undisturbed
):
    run_dir = small_disk / "run"
    learner = begun(harness, run_dir)
    fill(small_disk)
    before = checkpoints(run_dir)
    assert learner.wait() == 1, learner.text
    assert "Traceback" not in learner.text
    assert f"error: the checkpoint of iteration {ITERATIONS} in {run_dir}" in learner.text
    assert "make room there and start the same command again" in learner.text
    assert "lines of the run's logs are still not on the disk" in learner.text
    assert checkpoints(run_dir) == before
    (small_disk / "ballast").unlink()
    again = harness.learner(*RUN, run_dir=run_dir)
    finished(again, run_dir, undisturbed)


def test_a_signal_on_a_full_disk_ends_the_run_in_a_sentence(harness, small_disk):
    """Four attempts, for the checkpoint twice and for result.json, are within the usual grace."""
    run_dir = small_disk / "run"
    learner = begun(harness, run_dir)
    fill(small_disk)
    says_that_it_cannot_write(learner)
    learner.send(signal.SIGTERM)
    assert learner.wait(GRACE) == 1, learner.text
    assert re.search("error: the checkpoint of iteration [0-9]+ in .* could not be", learner.text)
    assert f"result.json in {run_dir} cannot be written" in learner.text
    assert "Traceback" not in learner.text


def test_a_run_does_not_begin_on_a_full_disk(harness, small_disk):
    run_dir = small_disk / "run"
    run_dir.mkdir()
    fill(small_disk)
    learner = harness.learner(*RUN, run_dir=run_dir)
    assert learner.wait() == 2, learner.text
    assert "Traceback" not in learner.text
    assert "No space left on device" in learner.text
