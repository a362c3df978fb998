"""The columns of an iteration: what README says to watch, worked out by hand."""

import math
from dataclasses import replace

import numpy as np
import pytest

from dppo.config import Config, RolloutConfig
from dppo.gradients import Sums
from dppo.moments import Moments
from dppo.networks import Networks
from learner.report import Finished, Training
from learner.state import State
from tests.story import COLLECTED, SPACES

CONFIG = Config(rollout=RolloutConfig(slots=3, num_envs=1, num_steps=64))
TENS = np.full((17, 2), 10.0)
"""Episodes of earlier iterations: returns of 10 in 10 steps."""


def collected(slot, targets, residuals, sigmas, episodes=(), start_sigma=()):
    """What a slot says when it has seen these."""
    starts = Moments.of(np.array(start_sigma, np.float64)).to_vector()
    columns = np.array([targets, residuals, sigmas], np.float64)
    mean = columns.mean(axis=1)
    m2 = ((columns.T - mean) ** 2).sum(axis=0)
    fit = np.concatenate([[len(targets)], mean, m2])
    ended = np.array(episodes, np.float64)
    return replace(COLLECTED, slot=slot, fit=fit, start_sigma=starts, episodes=ended)


THREE = [
    collected(0, [0, 2], [0, 1], [1, 3], [1, 5], start_sigma=[1, 4]),
    collected(1, [4], [1], [5], start_sigma=[10]),
    collected(2, [2], [0], [3], [3, 7, 6, 9]),
]


def report(training):
    networks = Networks.build(SPACES, CONFIG)
    before = State.initial(networks, SPACES.obs_size, CONFIG).with_episodes(TENS)
    new = np.concatenate([answer.episodes.reshape(-1, 2) for answer in THREE])
    after = replace(before.with_episodes(new), iteration=7, beta=2.0)
    return Finished(
        before=before, after=after, collected=THREE, training=training, config=CONFIG,
        num_workers=2,
    ).report()  # fmt: skip


def test_the_columns_to_watch_are_those_of_all_slots_together():
    """20 episodes: 17 of return 10, and 1, 3, 6, of which the first two are the worst tenth."""
    found = report(Training(psi=0.1, beta=1.0, advantage_stds=(1.0, 2.0, 3.0)))
    metrics = found.metrics
    assert metrics["rollout/ep_rew_mean"] == (17 * 10 + 1 + 3 + 6) / 20
    assert metrics["rollout/ep_len_mean"] == (17 * 10 + 5 + 7 + 9) / 20
    # mean of squares (1700 + 1 + 9 + 36) / 20 = 87.3, square of the mean 9 * 9
    assert metrics["safety/return_std"] == pytest.approx(math.sqrt(87.3 - 81))
    assert metrics["safety/cvar10"] == (1 + 3) / 2
    assert metrics["charts/episodic_return"] == 6
    assert metrics["safety/sigma_mean"] == (1 + 3 + 5 + 3) / 4
    assert "train/std" not in metrics  # actions are choices
    assert metrics["safety/start_sigma"] == (1 + 4 + 10) / 3  # of the episodes that began
    # squared deviations: of the targets 0, 2, 4, 2 from 2; of what is left, 0, 1, 1, 0, from 0.5
    assert metrics["train/explained_variance"] == pytest.approx(1 - 1 / 8)
    assert (metrics["safety/adv_v_std"], metrics["safety/adv_sigma_std"]) == (1.0, 2.0)
    assert (metrics["safety/psi"], metrics["train/kl_coef"]) == (0.1, 2.0)
    assert metrics["train/gamma"] == pytest.approx(0.99)  # that of the first iteration
    assert found.episodes == ((1.0, 5.0), (3.0, 7.0), (6.0, 9.0))
    assert (found.iteration, found.env_steps) == (7, 7 * 3 * 64)


def test_losses_are_means_over_the_samples_of_all_updates():
    """The second update is the critics' alone."""
    training = Training(psi=0.1, beta=1.0, advantage_stds=(1.0, 1.0, 1.0))
    training.note(
        Sums(policy_weight=4, critic_weight=4, objective=2, value_loss=8, variance_loss=1), False
    )
    training.note(Sums(critic_weight=12, value_loss=8, variance_loss=7), False)
    training.kls = [(1.0, 10.0), (4.0, 15.0)]
    metrics = report(training).metrics
    assert metrics["train/policy_loss"] == -2 / 4
    assert metrics["train/value_loss"] == (8 + 8) / (4 + 12)
    assert metrics["train/variance_loss"] == (1 + 7) / (4 + 12)
    assert metrics["train/policy_updates"] == 1
    assert metrics["train/kl"] == (1 + 4) / (10 + 15)
