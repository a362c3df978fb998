"""A trained policy outside the trainer: NumPy, torch and the command line agree."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from dppo.store.checkpoint import load_checkpoint
from dppo.torch_policy import PolicyModule
from tests.support import SMALL, Harness, checkpoints
from workers.envs import make_env
from workers.evaluate import FrozenPolicy, evaluate


@pytest.fixture(scope="module")
def run_dir(tmp_path_factory):
    harness = Harness(tmp_path_factory.mktemp("train"))
    run_dir = harness.folder / "run"
    args = ("--env", "Hopper-v5", *SMALL, "--total-timesteps", "1536", "--local-workers", "1")
    harness.train(*args, run_dir=run_dir)
    return run_dir


def newest(run_dir: Path):
    return load_checkpoint(run_dir / "checkpoints" / checkpoints(run_dir)[-1])


def test_equal_arguments_give_equal_returns_and_other_seeds_others(run_dir):
    checkpoint = newest(run_dir)
    first = evaluate(checkpoint, episodes=3, deterministic=False, seed=1)
    assert evaluate(checkpoint, episodes=3, deterministic=False, seed=1) == first
    assert evaluate(checkpoint, episodes=3, deterministic=False, seed=2) != first
    assert evaluate(checkpoint, episodes=3, deterministic=True, seed=1) != first


def test_the_torch_module_acts_like_the_trainer_policy(run_dir):
    checkpoint = newest(run_dir)
    policy = FrozenPolicy(checkpoint, make_env(policy_config(checkpoint)))
    module = PolicyModule.load(checkpoint, -0.2, 0.2)
    obs = np.random.default_rng(0).normal(size=(16, 11))
    expected = np.stack([policy.act(row, 0, None) for row in obs])
    with torch.no_grad():
        actions = module(torch.from_numpy(obs)).numpy()
    np.testing.assert_allclose(actions, np.clip(expected, -0.2, 0.2), atol=2e-6)
    assert np.abs(expected).max() > 0


def policy_config(checkpoint):
    from dppo.config import Config

    return Config.from_dict(checkpoint.facts["config"]).run


def test_dppo_eval_prints_mean_spread_and_tail(harness, run_dir):
    process = harness.start("dppo", "eval", str(run_dir), "--episodes", "4", "--json")
    assert process.wait() == 0, process.text
    printed = json.loads(process.text)
    returns = np.array(printed["returns"])
    assert printed["episodes"] == len(returns) == 4
    assert printed["return_mean"] == pytest.approx(returns.mean())
    assert printed["return_std"] == pytest.approx(returns.std())
    assert printed["return_cvar10"] == returns.min()  # a tenth of 4 episodes: the worst one


def test_dppo_checkpoint_shows_hashes_and_contents(harness, run_dir):
    process = harness.start("dppo", "checkpoint", str(run_dir))
    assert process.wait() == 0, process.text
    printed = json.loads(process.text)
    outcome = json.loads((run_dir / "result.json").read_text())
    assert printed["parameters_sha256"] == outcome["parameters_sha256"]
    assert printed["state"]["iteration"] == 3
    assert {"policy_sha256", "value_sha256", "variance_sha256"} <= printed.keys()
    assert "slot/7" in printed["arrays"]


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["eval", "/nowhere"], "/nowhere holds no checkpoint"),
        (["eval", "{run}", "--which", "latest"], "--which is latest, expected best, newest"),
        (["eval", "{run}", "--episodes", "0"], "--episodes is 0, expected >= 1"),
        (["train"], "found train, expected eval, checkpoint, replay, four-rooms, bench or chaos"),
        ([], "found nothing, expected eval, checkpoint, replay, four-rooms, bench or chaos"),
    ],
)
def test_wrong_usage_is_one_sentence_and_code_2(harness, run_dir, words, sentence):
    process = harness.start("dppo", *(word.format(run=run_dir) for word in words))
    assert process.wait() == 2
    assert sentence in " ".join(process.text.replace("│", " ").split())
    assert "Traceback" not in process.text
