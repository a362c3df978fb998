"""Bad input ends in one sentence and exit code 2, never in a traceback, and leaves nothing."""

import json
import signal

import pytest

from learner.local import free_address
from tests.support import SMALL, checkpoints, descendants, is_alive, iterations, wait_until

TINY = ("--env", "CartPole-v1", *SMALL, "--update-epochs", "1")


def refuses(process, *words):
    """The process ended with code 2 and a sentence that has these words."""
    assert process.wait() == 2, process.text
    text = " ".join(process.text.replace("│", " ").split())
    assert "Traceback" not in text
    for word in words:
        assert word in text, process.text


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (["--psi", "nan"], ["--psi is nan, expected a finite number"]),
        (["--drop", "8"], ["--drop is 8, expected 0 <= drop < slots = 8"]),
        (["--ppsi", "0.1"], ["--ppsi", "Perhaps you meant", "--psi"]),
        (["--num-minibatches", "7"], ["--num-minibatches is 7, expected a divisor of the 64"]),
        (["--total-timesteps", "many"], ["--total-timesteps", "'many'"]),
        (["--preset", "best"], ["--preset is 'best', expected one of default, paper"]),
        (["--config", __file__], ["is not a readable config file (JSON or TOML)"]),
        (["--run-dir", f"{__file__}/run"], ["cannot be written", "give a folder of yours"]),
        (["--listen", "tcp/192.0.2.1:7447", "--insecure"], ["cannot listen on tcp/192.0.2.1"]),
        (
            ["--listen", "tcp/127.0.0.1:port", "--insecure"],
            ["--listen is 'tcp/127.0.0.1:port', expected an address"],
        ),
        (["--name", "../../run"], ["--name is '../../run', expected no '/'"]),
        (["--listen", "tcp/0.0.0.0:7447"], ["without encryption", "--insecure"]),
    ],
    ids=lambda value: " ".join(value) if isinstance(value[0], str) else None,
)
def test_the_learner_refuses(harness, args, words):
    refuses(harness.start("learner", *TINY, *args), *words)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("args", "words"),
    [
        (["--env", "Antt-v4"], ["--env is 'Antt-v4'", "did you mean Ant-v4"]),
        (["--env", "CartPole-v1", "--env-kwargs", '{"wind": 3}'], ["cannot be made", "wind"]),
        (["--env", "tests.odd_envs:OddActions-v0"], ["action space MultiBinary", "Discrete"]),
        (["--env", "tests.odd_envs:OddObservations-v0"], ["observation space Text", "Box"]),
    ],
    ids=["unknown", "kwargs", "action space", "observation space"],
)
def test_an_environment_that_cannot_be_trained_on_is_named(harness, args, words):
    run_dir = harness.folder / "run"
    learner = harness.learner(*SMALL, *args, "--local-workers", "1", run_dir=run_dir)
    refuses(learner, *words)
    assert not run_dir.exists()


def test_a_taken_port_is_refused(harness):
    address = free_address()
    first = harness.learner(
        *TINY, "--local-workers", "0", "--listen", address, run_dir=harness.folder / "a"
    )
    wait_until(lambda: "training CartPole-v1" in first.text, "the first learner to listen")
    second = harness.learner(
        *TINY, "--local-workers", "0", "--listen", address, run_dir=harness.folder / "b"
    )
    refuses(second, f"cannot listen on {address}", "give --listen a free address")


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (
            ["--connect", "nonsense"],
            ["--connect is 'nonsense', expected an address such as"],
        ),
        (["--connect", "tcp/127.0.0.1:port"], ["--connect is 'tcp/127.0.0.1:port'"]),
        (["--connect", "tcp/127.0.0.1:9", "--wait-seconds", "0.2"], ["no learner answered"]),
        (["--connect", "tcp/127.0.0.1:9", "--name", "a/b"], ["--name is 'a/b'"]),
        (["--connect", "tcp/127.0.0.1:9", "--name", 58 * "a"], ["expected at most 57 of the"]),
        ([], ["--connect"]),
    ],
    ids=["malformed", "port", "unreachable", "name", "long name", "missing"],
)
def test_the_worker_refuses(harness, args, words):
    refuses(harness.start("workers", *args), *words)


@pytest.mark.slow
def test_a_run_directory_of_another_config_is_refused_with_the_differences(harness):
    run_dir = harness.folder / "run"
    harness.train(*TINY, "--total-timesteps", "512", "--local-workers", "1", run_dir=run_dir)
    other = harness.learner(*TINY, "--total-timesteps", "512", "--gamma", "0.9", run_dir=run_dir)
    refuses(other, "holds a run with other settings: --gamma was 0.995, is 0.9")
    never = harness.learner(
        *TINY, "--total-timesteps", "512", "--resume", "never", run_dir=run_dir
    )
    refuses(never, "holds a run and --resume is never")


@pytest.mark.slow
def test_a_corrupt_checkpoint_falls_back_and_says_so(harness):
    args = (*TINY, "--total-timesteps", "3072", "--checkpoint-every", "2", "--local-workers", "1")
    whole = harness.train(*args, run_dir=harness.folder / "whole")
    run_dir = harness.folder / "run"
    harness.train(*args, "--stop-at", "2048", run_dir=run_dir)
    newest = run_dir / "checkpoints" / checkpoints(run_dir)[-1] / "arrays.safetensors"
    damaged = bytearray(newest.read_bytes())
    damaged[len(damaged) // 2] ^= 1
    newest.write_bytes(damaged)
    again = harness.learner(*args, run_dir=run_dir)
    assert again.wait() == 0, again.text
    assert "does not match its checksum; falling back" in again.text
    assert "resuming at iteration 2 of 6" in again.text
    outcome = json.loads((run_dir / "result.json").read_text())
    assert outcome["parameters_sha256"] == whole["parameters_sha256"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("env", "words"),
    [
        ("Raises-v0", ["raised RuntimeError: the arm fell off"]),
        ("NotANumber-v0", ["returned a observation [nan, 0.0] that is not finite"]),
    ],
)
def test_an_environment_that_fails_on_the_way_is_named(harness, env, words):
    run_dir = harness.folder / "run"
    learner = harness.learner(
        *SMALL, "--env", f"tests.odd_envs:{env}", "--local-workers", "2", "--checkpoint-every",
        "1", run_dir=run_dir,
    )  # fmt: skip
    assert learner.wait() == 1, learner.text
    for word in ["error: slot ", ", environment 0 (", " at step 10 of episode ", *words]:
        assert word in learner.text, learner.text
    assert "Traceback" not in learner.text
    assert json.loads((run_dir / "result.json").read_text())["status"] == "failed"


@pytest.mark.slow
def test_nothing_is_left_running_after_ctrl_c(harness):
    learner = harness.learner(*TINY, "--local-workers", "2", run_dir=harness.folder / "run")
    wait_until(lambda: iterations(harness.folder / "run") >= 1, "an iteration")
    workers = descendants(learner.popen.pid)
    assert len(workers) == 2
    learner.send(signal.SIGINT)
    assert learner.wait() == 0, learner.text
    wait_until(lambda: not any(map(is_alive, workers)), "the workers to end")
