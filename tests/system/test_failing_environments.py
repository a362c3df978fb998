"""Environments that hang, crash or raise: once, and the run goes on; always, and it stops."""

import json

import pytest

from tests.support import SMALL, checkpoints, iterations, result, wait_until

pytestmark = pytest.mark.slow
RUN = (
    "--env", "tests.odd_envs:Walk-v0", *SMALL, "--total-timesteps", str(60 * 8 * 64),
    "--local-workers", "2", "--patience", "1", "--verbose",
)  # fmt: skip
SAID = {
    "hang": "alive but without progress for",
    "hold": "silent for",
    "segfault": "died with exit code -11 (SIGSEGV",
    "memory": "died with exit code -9 (SIGKILL: from somebody, or from the system for want",
    "exit": "died with exit code 3",
    "raise": "it is tried once more",
}


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """The hash of the run when nothing goes wrong."""
    from tests.support import Harness

    harness = Harness(tmp_path_factory.mktemp("undisturbed"))
    once = harness.folder / "once"
    outcome = harness.train(*RUN, *kwargs("none", once), run_dir=harness.folder / "run")
    return outcome["parameters_sha256"]


def kwargs(trouble, once):
    values = {"trouble": trouble, "once": str(once), "after": 2000}
    return ("--env-kwargs", json.dumps(values))


@pytest.mark.parametrize("trouble", SAID)
def test_an_environment_that_goes_wrong_once_costs_no_bits(harness, undisturbed, trouble):
    run_dir, once = harness.folder / "run", harness.folder / "once"
    learner = harness.learner(*RUN, *kwargs(trouble, once), run_dir=run_dir)
    assert learner.wait() == 0, learner.text
    assert once.exists()
    assert SAID[trouble] in learner.text
    assert result(run_dir)["parameters_sha256"] == undisturbed


def test_an_environment_that_always_raises_stops_the_run_after_its_checkpoint_is_safe(
    harness, undisturbed
):
    """Nothing else would save one; when all is well again the same command goes on."""
    run_dir, broken = harness.folder / "run", harness.folder / "broken"
    values = json.dumps({"while_there": str(broken)})
    command = (*RUN, "--env-kwargs", values, "--checkpoint-every", "1000")
    learner = harness.learner(*command, run_dir=run_dir)
    wait_until(lambda: iterations(run_dir) >= 3, "three iterations")
    broken.touch()
    assert learner.wait() == 1, learner.text
    last = learner.text.splitlines()[-1]
    assert last.startswith("error: slot ")
    assert "raised RuntimeError: the arm fell off" in last
    assert "it is the second time, after worker local-" in last
    assert result(run_dir)["iterations"] >= 3
    assert checkpoints(run_dir) == [f"iteration-{result(run_dir)['iterations']:08d}"]
    broken.unlink()
    assert harness.train(*command, run_dir=run_dir)["parameters_sha256"] == undisturbed
