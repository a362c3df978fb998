"""The guarantee: the parameters are a function of config and seed, of nothing else."""

import os
from pathlib import Path

import pytest

from learner.local import free_address
from tests.support import SMALL, Harness, iterations, result

ENVS = ["Hopper-v5", "Ant-v4", "CartPole-v1"]
TEN_ITERATIONS = ("--total-timesteps", str(10 * 8 * 64))


def sha(harness: Harness, name: str, *args: str, env: str, workers: int, seed: int = 0) -> str:
    run_dir = harness.folder / name
    outcome = harness.train(
        "--env", env, "--seed", str(seed), *SMALL, *TEN_ITERATIONS,
        "--local-workers", str(workers), *args, run_dir=run_dir,
    )  # fmt: skip
    assert outcome["status"] == "finished"
    assert iterations(run_dir) == outcome["iterations"] == 10
    digest: str = outcome["parameters_sha256"]
    return digest


def test_one_and_three_workers_give_the_same_bits(harness):
    one = sha(harness, "one", env="Hopper-v5", workers=1)
    assert sha(harness, "three", env="Hopper-v5", workers=3) == one


@pytest.mark.slow
def test_the_trvo_baseline_has_the_same_bits_too_and_others_than_without(harness):
    args = ("--reward-variance", "0.3")
    one = sha(harness, "one", *args, env="Hopper-v5", workers=1)
    assert sha(harness, "three", *args, env="Hopper-v5", workers=3) == one
    assert sha(harness, "plain", env="Hopper-v5", workers=2) != one


@pytest.mark.slow
@pytest.mark.parametrize("env", ENVS)
def test_any_number_of_workers_gives_the_same_bits(harness, env):
    hashes = {
        workers: sha(harness, f"w{workers}", env=env, workers=workers) for workers in (1, 2, 3, 5)
    }
    assert len(set(hashes.values())) == 1, hashes
    assert sha(harness, "seed", env=env, workers=2, seed=1) != hashes[1]


@pytest.mark.slow
@pytest.mark.parametrize("env", ENVS)
def test_external_workers_and_a_resumed_run_give_the_same_bits(harness, env):
    local = sha(harness, "local", env=env, workers=2)

    address, run_dir = free_address(), harness.folder / "external"
    workers = [harness.worker(address), harness.worker(address)]
    learner = harness.learner(
        "--env", env, *SMALL, *TEN_ITERATIONS, "--local-workers", "0", "--listen", address,
        run_dir=run_dir,
    )  # fmt: skip
    assert learner.wait() == 0, learner.text
    assert [worker.wait() for worker in workers] == [0, 0]
    assert result(run_dir)["parameters_sha256"] == local

    third = harness.folder / "third"
    args = ("--env", env, *SMALL, *TEN_ITERATIONS, "--local-workers", "3")
    paused = harness.train(*args, "--stop-at", str(3 * 8 * 64), run_dir=third)
    assert (paused["status"], paused["iterations"]) == ("stopped", 3)
    resumed = harness.train(*args, run_dir=third)
    assert (resumed["status"], resumed["restarts"]) == ("finished", 1)
    assert resumed["parameters_sha256"] == local
    assert iterations(third) == 10


@pytest.mark.slow
@pytest.mark.parametrize(
    "args",
    [
        ("--kl-scope", "worker", "--kl-target", "0.0005"),
        ("--preset", "heess2017", "--num-steps", "100"),
        ("--preset", "paper", "--slots", "4", "--num-steps", "50", "--critic-minibatches", "5"),
        (
            "--preset",
            "authors-2019",
            "--slots",
            "6",
            "--num-steps",
            "40",
            "--critic-minibatches",
            "2",
        ),
        ("--critic-replay", "--time-limit", "time-feature"),
        ("--slots", "5", "--adv-norm", "joint", "--variance-limit", "1"),
    ],
    ids=[
        "kl-scope-worker",
        "heess2017",
        "paper",
        "authors-2019",
        "replay-and-time-feature",
        "five-slots-variance-limit",
    ],
)
def test_switches_keep_the_same_bits(harness, args):
    hashes = set()
    for workers in (1, 3):
        run_dir = harness.folder / str(workers)
        flags = args if args[0] == "--preset" else (*SMALL, *args)
        outcome = harness.train(
            "--env", "Hopper-v5", *flags, "--local-workers", str(workers),
            "--total-timesteps", "1200", run_dir=run_dir,
        )  # fmt: skip
        assert outcome["dropped_gradients"] == 0
        hashes.add(outcome["parameters_sha256"])
    assert len(hashes) == 1


@pytest.mark.slow
def test_the_wheel_of_time_does_not_matter(harness):
    """One worker is nice'd to crawl: arrivals come in another order, bits do not change."""
    fast = sha(harness, "fast", env="CartPole-v1", workers=2)
    address, run_dir = free_address(), Path(harness.folder / "slow")
    harness.worker(address, "--name", "a")
    slow = harness.worker(address, "--name", "b")
    os.setpriority(os.PRIO_PROCESS, slow.popen.pid, 19)
    learner = harness.learner(
        "--env", "CartPole-v1", *SMALL, *TEN_ITERATIONS, "--local-workers", "0",
        "--listen", address, run_dir=run_dir,
    )  # fmt: skip
    assert learner.wait() == 0, learner.text
    assert result(run_dir)["parameters_sha256"] == fast
