"""A policy in another environment than its run's."""

import json
from functools import partial

import pytest

from tests.support import newest_checkpoint
from workers.evaluate import evaluate, policy_of


@pytest.fixture(scope="module")
def run_dir(runs):
    return runs("Hopper-v5")


@pytest.mark.slow
def test_a_policy_can_be_played_elsewhere(run_dir):
    play_in = partial(evaluate, episodes=3, deterministic=True, seed=3)
    checkpoint = newest_checkpoint(run_dir)
    at_home, noisy = play_in(policy_of(checkpoint)), "HopperActionNoise-v5"
    assert play_in(policy_of(checkpoint, noisy, '{"noise_std": 0.0}')) == at_home
    assert play_in(policy_of(checkpoint, noisy)) != at_home
    free, paid = (
        play_in(policy_of(checkpoint, env_kwargs=f'{{"healthy_reward": {reward}}}'))
        for reward in (0.0, 2.0)
    )
    for less, more in zip(free.episodes, paid.episodes, strict=True):
        assert more.total - less.total == pytest.approx(
            2 * (less.length - less.terminated)  # the step of a fall is not paid for
        )


@pytest.mark.slow
def test_dppo_eval_plays_elsewhere(harness, run_dir):
    env, kwargs = "HopperActionNoise-v5", '{"noise_std": 0.5}'
    words = ("--which", "newest", "--episodes", "2", "--env", env, "--env-kwargs", kwargs)
    process = harness.start("dppo", "eval", str(run_dir), *words, "--json")
    assert process.wait() == 0, process.text
    printed = json.loads(process.text)
    assert (printed["env"], printed["env_kwargs"]) == (env, kwargs)
    policy = policy_of(newest_checkpoint(run_dir), env, kwargs)
    found = evaluate(policy, episodes=2, deterministic=False, seed=0)
    assert [one["return"] for one in printed["episodes"]] == [one.total for one in found.episodes]
    told = harness.start("dppo", "eval", str(run_dir), *words)
    assert told.wait() == 0, told.text
    assert told.text.startswith(f"{env} {kwargs} (trained on Hopper-v5), iteration-")


@pytest.mark.slow
def test_the_runs_own_environment_keeps_its_keyword_arguments(runs):
    kwargs = '{"reset_noise_scale": 0.02}'
    checkpoint = newest_checkpoint(runs("InvertedPendulum-v5", "--env-kwargs", kwargs))
    for words in ((), ("InvertedPendulum-v5",)):
        assert policy_of(checkpoint, *words).config.run.env_kwargs == kwargs
    assert policy_of(checkpoint, "InvertedPendulum-v4").config.run.env_kwargs == "{}"
