"""`--restarts`: the learner comes back by itself, and nothing outlives its supervisor."""

import os
import signal

import pytest

from tests.support import (
    SMALL,
    checkpoints,
    descendants,
    is_alive,
    iterations,
    result,
    wait_until,
)

pytestmark = pytest.mark.slow
RUN = (
    "--env", "Hopper-v5", *SMALL, "--total-timesteps", str(100 * 8 * 64),
    "--checkpoint-every", "2", "--local-workers", "2",
)  # fmt: skip
RUN_0 = (*RUN[:-1], "0")


def learner_of(supervisor, other_than=0):
    """The process id of the learner that the supervisor has started."""
    found: list[int] = []

    def there():
        found[:] = [pid for pid in descendants(supervisor.popen.pid) if pid != other_than]
        return len(found) == 1

    wait_until(there, "the supervisor to start a learner")
    return found[0]


def resident_mib(pid):
    """Memory of a process [MiB]."""
    with open(f"/proc/{pid}/statm") as file:  # noqa: PTH123  one number of the kernel's
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20


def test_a_learner_killed_twice_finishes_by_itself_with_the_same_bits(harness, undisturbed):
    run_dir = harness.folder / "run"
    supervisor = harness.learner(*RUN, "--restarts", "3", run_dir=run_dir)
    victim = 0
    for wanted in (5, 15):
        victim = learner_of(supervisor, other_than=victim)
        wait_until(lambda: iterations(run_dir) >= wanted, f"{wanted} iterations")  # noqa: B023
        if wanted == 5:
            assert resident_mib(supervisor.popen.pid) < 30
        os.kill(victim, signal.SIGKILL)
    assert supervisor.wait() == 0, supervisor.text
    outcome = result(run_dir)
    assert outcome["parameters_sha256"] == undisturbed
    assert outcome["restarts"] == 2
    for told in ("restart 1 of 3, 2 left", "restart 2 of 3, 1 left"):
        assert told in supervisor.text
    assert supervisor.text.count("the learner was ended by SIGKILL after") == 2


def test_external_workers_find_the_learner_again_at_an_address_chosen_by_itself(
    harness, undisturbed
):
    run_dir = harness.folder / "run"
    supervisor = harness.learner(*RUN_0, "--restarts", "1", run_dir=run_dir)
    wait_until(lambda: "--connect tcp/" in supervisor.text, "the learner to say its address")
    address = supervisor.text.split("--connect ")[1].split()[0]
    worker = harness.worker(address)
    wait_until(lambda: len(checkpoints(run_dir)) >= 2, "two checkpoints")
    os.kill(learner_of(supervisor), signal.SIGKILL)
    assert supervisor.wait() == 0, supervisor.text
    assert worker.wait() == 0, worker.text
    assert "(generation 2)" in worker.text
    assert result(run_dir)["parameters_sha256"] == undisturbed


def test_killing_the_supervisor_leaves_nothing_behind_but_a_checkpoint(harness, undisturbed):
    run_dir = harness.folder / "run"
    supervisor = harness.learner(*RUN, "--restarts", "3", run_dir=run_dir)
    wait_until(lambda: iterations(run_dir) >= 5, "five iterations")
    learner = learner_of(supervisor)
    family = [learner, *descendants(learner)]
    assert len(family) == 3
    supervisor.kill()
    wait_until(lambda: not any(map(is_alive, family)), "the learner and its workers to end")
    outcome = result(run_dir)
    assert outcome["status"] == "stopped"
    assert checkpoints(run_dir)[-1] == f"iteration-{outcome['iterations']:08d}"
    assert "the supervisor, pid" in (run_dir / "log.txt").read_text()
    assert harness.train(*RUN, run_dir=run_dir)["parameters_sha256"] == undisturbed


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_to_the_supervisor_ends_the_learner_gracefully_and_for_good(harness, number):
    run_dir = harness.folder / "run"
    supervisor = harness.learner(*RUN, "--restarts", "3", run_dir=run_dir)
    wait_until(lambda: iterations(run_dir) >= 3, "three iterations")
    learner = learner_of(supervisor)
    os.kill(learner, number)  # as when a whole group of processes gets it
    supervisor.send(number)
    assert supervisor.wait() == 0, supervisor.text
    assert not is_alive(learner)
    assert result(run_dir)["status"] == "stopped"
    assert "starting it again" not in supervisor.text


def test_a_second_signal_ends_a_learner_that_does_not_answer(harness):
    run_dir = harness.folder / "run"
    supervisor = harness.learner(*RUN, "--restarts", "3", run_dir=run_dir)
    wait_until(lambda: iterations(run_dir) >= 3, "three iterations")
    learner = learner_of(supervisor)
    workers = descendants(learner)
    os.kill(learner, signal.SIGSTOP)
    supervisor.send(signal.SIGTERM)
    supervisor.send(signal.SIGINT)  # another one, so that the two cannot become one
    assert supervisor.wait() in (128 + signal.SIGTERM, 128 + signal.SIGINT), supervisor.text
    wait_until(lambda: not any(map(is_alive, [learner, *workers])), "everything to end")


def test_wrong_usage_is_not_started_again(harness):
    supervisor = harness.start(
        "learner", *SMALL, "--env", "Antt-v4", "--restarts", "3", "--local-workers", "1"
    )
    assert supervisor.wait() == 2, supervisor.text
    assert "did you mean Ant-v4" in supervisor.text
    assert "starting it again" not in supervisor.text


def test_a_run_that_fails_each_time_uses_up_its_restarts_and_ends_as_the_learner_did(harness):
    supervisor = harness.learner(
        *SMALL, "--env", "tests.odd_envs:Raises-v0", "--restarts", "1", "--local-workers", "1",
        "--checkpoint-every", "1", "--resume", "never", run_dir=harness.folder / "run",
    )  # fmt: skip
    assert supervisor.wait() == 1, supervisor.text
    assert supervisor.text.count("error: slot ") == 2, supervisor.text
    assert "restart 1 of 1, 0 left" in supervisor.text
    assert "no restart is left of --restarts 1" in supervisor.text


def test_impossible_restarts_are_refused(harness):
    supervisor = harness.start("learner", *SMALL, "--restarts", "-1")
    assert supervisor.wait() == 2
    assert "--restarts is -1, expected >= 0" in supervisor.text
