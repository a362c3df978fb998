"""The learner dies between two lines of its loop, or stops: the same bits, nobody is blamed."""

import json
import signal

import pytest

from learner.local import free_address
from tests.support import SMALL, Harness, checkpoints, iterations, result, wait_until

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


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """The hash of the run when nothing happens to it."""
    harness = Harness(tmp_path_factory.mktemp("undisturbed"))
    outcome = harness.train(*RUN, "--local-workers", "2", run_dir=harness.folder / "run")
    return outcome["parameters_sha256"]


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
