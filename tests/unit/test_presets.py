"""The recipes have the numbers of their sources (docs/decisions/0013 and after)."""

import json
import math

import pytest

from dppo.config import Config
from dppo.presets import PRESETS, authors_2019, default, heess2017, paper

ENVS = ["HalfCheetah-v4", "Hopper-v4", "Ant-v4", "Walker2d-v4"]
SIZES = {
    "HalfCheetah": (17, 6), "Hopper": (11, 3), "Ant": (27, 8), "Walker2d": (17, 6),
    "Ant-v5": (105, 8),
}  # fmt: skip
"""Observation and action size, of -v4 and, where no other is here, -v5."""


@pytest.mark.parametrize("env", [*ENVS, "Humanoid-v5", "CartPole-v1"])
@pytest.mark.parametrize("name", PRESETS)
def test_every_preset_is_a_valid_config_of_every_environment(name, env):
    config = PRESETS[name](env)
    assert config.run.env == env
    assert Config.from_dict(json.loads(json.dumps(config.to_dict()))) == config


def test_there_are_the_four_presets():
    assert list(PRESETS) == ["default", "paper", "authors-2019", "heess2017"]


def test_default():
    config = default("Ant-v4")
    assert config.network.hidden_sizes == (64, 64)
    assert (config.returns.gamma_start, config.returns.gamma) == (0.99, 0.995)
    assert config.returns.gae_lambda == 0.95
    assert config.kl.kl_target == 0.02
    assert config.update.lr_schedule == "linear"
    assert config.update.num_minibatches > 1
    assert (config.update.learning_rate, config.update.critic_learning_rate) == (1e-3, 2e-3)
    assert config.safety.psi == 0
    assert config.safety.adv_norm == "separate"
    assert config.safety.sigma_head == "softplus"
    assert config.rollout.time_limit == "bootstrap"
    assert config.kl.kl_scope == "chief"


@pytest.mark.parametrize(
    ("env", "psi"),
    [("HalfCheetah-v4", 0.15), ("Ant-v4", 0.1), ("Hopper-v4", 0.075), ("Walker2d-v5", 0.075)],
)
def test_paper_has_the_psi_of_table_2(env, psi):
    assert paper(env).safety.psi == psi
    assert authors_2019(env).safety.psi == psi


@pytest.mark.parametrize("env", ENVS)
def test_paper(env):
    config = paper(env)
    assert (config.returns.gamma, config.returns.gae_lambda) == (0.995, 0.98)
    assert config.returns.gamma_start == -1  # all along
    assert config.returns.lambda_ret == -1
    assert config.returns.variance_discount == (0.995 * 0.98) ** 2
    assert config.kl.kl_target == 0.003
    assert config.kl.hinge_coef == 50
    assert config.network.architecture == "paper"
    assert config.network.log_std_init == -0.5  # log variance -1
    assert config.update.update_epochs == 20
    assert config.update.num_minibatches == 1
    assert config.update.critic_replay
    assert config.rollout.reward_scale == "one-minus-gamma"
    assert config.rollout.time_limit == "time-feature"
    assert config.rollout.normalize_obs == "paper"
    assert config.safety.sigma_head == "linear"
    assert config.safety.adv_norm == "separate"


@pytest.mark.parametrize(("env", "episodes"), [(e, 5 if "Half" in e else 20) for e in ENVS])
def test_paper_learns_from_20_full_episodes_or_5_of_half_cheetah(env, episodes):
    rollout = paper(env).rollout
    assert rollout.samples == episodes * 1000
    assert rollout.num_steps == 1000
    assert rollout.window == 0


@pytest.mark.parametrize("env", [*ENVS, "Ant-v5", "Hopper-v5", "workers.hazards:AntRiskySpeed-v5"])
def test_paper_has_the_step_sizes_of_its_network_sizes(env):
    kind = next(kind for kind in SIZES if kind in env)
    obs, action = SIZES.get(kind + env[-3:], SIZES[kind])
    inputs = obs + 1  # the time feature
    policy = math.isqrt(inputs * 10 * action * 10)
    critic = math.isqrt(inputs * 10 * 5)
    update = paper(env).update  # 9e-4/√h2 and 1e-2/√h2, to three digits
    assert f"{update.learning_rate:.2e}" == f"{9e-4 / math.sqrt(policy):.2e}"
    assert f"{update.critic_learning_rate:.2e}" == f"{1e-2 / math.sqrt(critic):.2e}"


def test_authors_2019_differs_from_paper_in_two_settings():
    before, after = paper("Hopper-v4").to_dict(), authors_2019("Hopper-v4").to_dict()
    changed = {
        name: value
        for group, fields in after.items()
        for name, value in fields.items()
        if value != before[group][name]
    }
    assert changed == {"gamma_bar": "authors-2019", "delta_reward": "raw"}
    assert authors_2019("Hopper-v4").returns.variance_discount == 0.995 * 0.98


def test_heess2017_has_windows_and_decides_per_worker():
    config = heess2017("Ant-v4")
    assert 0 < config.rollout.window < config.rollout.num_steps
    assert (config.returns.gamma_start, config.returns.gamma) == (-1, 0.99)
    assert config.returns.gae_lambda == 1  # K-step returns
    assert config.update.num_minibatches == 1
    assert config.update.lr_schedule == "constant"
    assert config.kl.kl_scope == "worker"
    assert config.safety.psi == 0


@pytest.mark.parametrize("name", ["HopperRiskySpeed-v4", "HopperActionNoise-v5", "mine:Hopper-v4"])
def test_kin_of_the_papers_environments_get_their_numbers(name):
    ours, theirs = paper(name), paper("Hopper-v4")
    assert (ours.safety, ours.update, ours.rollout) == (
        theirs.safety,
        theirs.update,
        theirs.rollout,
    )
    assert paper("Swimmer-v4").safety.psi == 0.1
