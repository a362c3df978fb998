"""--gamma-start: the γ of an iteration is the one that its rollouts and its policy have."""

from dataclasses import asdict, replace

import numpy as np
import pytest

from dppo.config import Config, ReturnsConfig, RolloutConfig, RunConfig, UpdateConfig
from dppo.distributions import distribution_of
from dppo.networks import Networks
from dppo.normalizer import Statistics
from learner.state import State
from workers.envs import make_env, spaces_of
from workers.evaluate import policy_of
from workers.slots import Slots

pytestmark = pytest.mark.usefixtures("quiet_libraries")
CONFIG = Config(
    run=RunConfig(env="HalfCheetah-v5", seed=3, total_timesteps=4 * 8),
    rollout=RolloutConfig(slots=1, num_envs=2, num_steps=4),
    update=UpdateConfig(num_minibatches=1),
    returns=ReturnsConfig(gamma=0.984375, gamma_start=0.75),
)
"""4 iterations: γ .75, .875, .9375, .96875."""


def test_returns_that_rewards_are_scaled_by_have_the_gamma_of_their_iteration():
    sizes = spaces_of(make_env(CONFIG.run))
    networks = Networks.build(sizes, CONFIG)
    slots = Slots.fresh([0], CONFIG)
    expected = np.zeros(2)
    for gamma in (0.75, 0.875, 0.9375):
        ((rollout, _),) = slots.collect(
            networks, distribution_of(sizes), networks.initial(CONFIG),
            Statistics.empty(sizes.obs_size),
        )  # fmt: skip
        for reward in rollout.reward:
            expected = gamma * expected + reward
        assert slots.environments.discounted == pytest.approx(expected)


def test_moved_in_the_middle_of_the_growth_a_slot_collects_the_same_bits():
    sizes = spaces_of(make_env(CONFIG.run))
    networks = Networks.build(sizes, CONFIG)
    with_settings = networks, distribution_of(sizes), networks.initial(CONFIG)
    statistics = Statistics.empty(sizes.obs_size)
    here = Slots.fresh([0], CONFIG)
    here.collect(*with_settings, statistics)
    there = Slots.restored([0], CONFIG, here.iteration, [here.snapshot(0)])
    (_, facts), (_, moved) = (s.collect(*with_settings, statistics)[0] for s in (here, there))
    assert moved.returns.to_vector().tobytes() == facts.returns.to_vector().tobytes()
    assert there.snapshot(0) == here.snapshot(0)


@pytest.mark.parametrize(("iteration", "gamma"), [(2, 0.9375), (4, 0.984375)])
def test_a_policy_has_the_gamma_of_its_checkpoint(iteration, gamma):
    sizes = spaces_of(make_env(CONFIG.run))
    state = State.initial(Networks.build(sizes, CONFIG), sizes.obs_size, CONFIG)
    checkpoint = replace(state, iteration=iteration).to_checkpoint(
        {"config": CONFIG.to_dict(), "spaces": asdict(sizes)}
    )
    assert policy_of(checkpoint).config.returns.gamma == pytest.approx(gamma)
