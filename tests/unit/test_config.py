"""Settings: refused with a sentence, and the same after any detour through JSON."""

import json
import math
import re
from dataclasses import FrozenInstanceError, fields, replace
from typing import Literal, get_args, get_origin, get_type_hints

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dppo.config import (
    Config,
    KlConfig,
    NetworkConfig,
    ReturnsConfig,
    RolloutConfig,
    RunConfig,
    SafetyConfig,
    UpdateConfig,
)
from dppo.presets import PRESETS

NAN, INF = math.nan, math.inf

REFUSED = [
    (RunConfig, {"seed": -1}, "--seed is -1, expected 0 <= seed < 2**63"),
    (RunConfig, {"seed": 2**63}, f"--seed is {2**63}, expected 0 <= seed < 2**63"),
    (RunConfig, {"total_timesteps": 0}, "--total-timesteps is 0, expected >= 1"),
    (RunConfig, {"env_kwargs": "{"}, "--env-kwargs is '{', expected a JSON object such as"),
    (RunConfig, {"env_kwargs": "[1]"}, "--env-kwargs is '[1]', expected a JSON object"),
    (RolloutConfig, {"slots": 0}, "--slots is 0, expected >= 1"),
    (RolloutConfig, {"slots": 4097}, "--slots is 4097, expected <= 4096"),
    (RolloutConfig, {"num_envs": 0}, "--num-envs is 0, expected >= 1"),
    (RolloutConfig, {"num_steps": 0}, "--num-steps is 0, expected >= 1"),
    (RolloutConfig, {"drop": 8}, "--drop is 8, expected 0 <= drop < slots = 8: an update needs"),
    (RolloutConfig, {"drop_limit": 0}, "--drop-limit is 0, expected >= 1"),
    (RolloutConfig, {"drop": -1}, "--drop is -1, expected 0 <= drop < slots = 8"),
    (RolloutConfig, {"window": -1}, "--window is -1, expected >= 0"),
    (
        RolloutConfig,
        {"window": 100},
        "--window is 100, expected 0 or a divisor of num_steps = 64",
    ),
    (RolloutConfig, {"window": 512}, "--window is 512, expected 0 or a divisor of num_steps"),
    (RolloutConfig, {"clip_obs": 0.0}, "--clip-obs is 0.0, expected > 0"),
    (RolloutConfig, {"clip_obs": NAN}, "--clip-obs is nan, expected > 0"),
    (ReturnsConfig, {"gamma": 1.5}, "--gamma is 1.5, expected 0 .. 1"),
    (ReturnsConfig, {"gamma": NAN}, "--gamma is nan, expected 0 .. 1"),
    (ReturnsConfig, {"gae_lambda": -0.1}, "--gae-lambda is -0.1, expected 0 .. 1"),
    (ReturnsConfig, {"lambda_ret": -0.5}, "--lambda-ret is -0.5, expected 0 .. 1, or -1 for"),
    (ReturnsConfig, {"lambda_ret": 1.1}, "--lambda-ret is 1.1, expected 0 .. 1, or -1 for"),
    (
        ReturnsConfig,
        {"gamma": 1.0},
        "--gamma is 1.0, expected < 1, or --gamma-start -1",
    ),
    (ReturnsConfig, {"gamma_start": -0.5}, "--gamma-start is -0.5, expected 0 .. 1, or -1 for"),
    (SafetyConfig, {"psi": NAN}, "--psi is nan, expected a finite number"),
    (SafetyConfig, {"psi": INF}, "--psi is inf, expected a finite number"),
    (SafetyConfig, {"psi": -0.1}, "--psi is -0.1, expected >= 0"),
    (SafetyConfig, {"reward_variance": -1.0}, "--reward-variance is -1.0, expected >= 0"),
    (SafetyConfig, {"reward_variance": INF}, "--reward-variance is inf, expected a finite number"),
    (SafetyConfig, {"psi_warmup": 1.0}, "--psi-warmup is 1.0, expected 0 <= psi_warmup < 1"),
    (SafetyConfig, {"psi_warmup": -0.1}, "--psi-warmup is -0.1, expected 0 <= psi_warmup < 1"),
    (SafetyConfig, {"variance_limit": 0.0}, "--variance-limit is 0.0, expected > 0"),
    (SafetyConfig, {"variance_limit": NAN}, "--variance-limit is nan, expected > 0"),
    (
        SafetyConfig,
        {"variance_limit_rate": INF},
        "--variance-limit-rate is inf, expected a finite",
    ),
    (SafetyConfig, {"variance_limit_rate": -1.0}, "--variance-limit-rate is -1.0, expected >"),
    (
        SafetyConfig,
        {"psi": 0.1, "variance_critic": False},
        "--variance-critic is False, expected on, because psi or variance_limit needs sigma",
    ),
    (
        SafetyConfig,
        {"variance_limit": 2.0, "variance_critic": False},
        "--variance-critic is False, expected on, because psi or variance_limit needs sigma",
    ),
    (
        SafetyConfig,
        {"variance_limit": 2.0, "psi_schedule": "linear"},
        "--psi-schedule is linear, expected constant, because variance_limit moves psi",
    ),
    (UpdateConfig, {"learning_rate": 0.0}, "--learning-rate is 0.0, expected > 0"),
    (UpdateConfig, {"learning_rate": INF}, "--learning-rate is inf, expected a finite number"),
    (UpdateConfig, {"critic_learning_rate": -1.0}, "--critic-learning-rate is -1.0, expected > 0"),
    (UpdateConfig, {"update_epochs": 0}, "--update-epochs is 0, expected >= 1"),
    (UpdateConfig, {"num_minibatches": 0}, "--num-minibatches is 0, expected >= 1"),
    (UpdateConfig, {"critic_epochs": -1}, "--critic-epochs is -1, expected >= 0"),
    (UpdateConfig, {"critic_minibatches": -1}, "--critic-minibatches is -1, expected >= 0"),
    (UpdateConfig, {"max_grad_norm": 0.0}, "--max-grad-norm is 0.0, expected > 0"),
    (UpdateConfig, {"max_grad_norm": NAN}, "--max-grad-norm is nan, expected > 0"),
    (UpdateConfig, {"adam_eps": 0.0}, "--adam-eps is 0.0, expected > 0"),
    (KlConfig, {"kl_target": 0.0}, "--kl-target is 0.0, expected > 0"),
    (KlConfig, {"kl_target": INF}, "--kl-target is inf, expected a finite number"),
    (KlConfig, {"kl_coef_scale": 1.0}, "--kl-coef-scale is 1.0, expected > 1"),
    (KlConfig, {"kl_low": 2.0}, "--kl-low is 2.0, expected 0 < kl_low < kl_high"),
    (KlConfig, {"kl_low": 0.0}, "--kl-low is 0.0, expected 0 < kl_low < kl_high"),
    (KlConfig, {"kl_coef": 36.0}, "--kl-coef is 36.0, expected kl_coef_min 0.0285714 .. "),
    (KlConfig, {"kl_coef": 0.02}, "--kl-coef is 0.02, expected kl_coef_min 0.0285714 .. "),
    (KlConfig, {"kl_coef_min": 0.0}, "--kl-coef is 1.0, expected kl_coef_min 0 .. kl_coef_max 35"),
    (KlConfig, {"hinge_coef": -1.0}, "--hinge-coef is -1.0, expected >= 0"),
    (KlConfig, {"kl_stop": 0.0}, "--kl-stop is 0.0, expected > 0"),
    (KlConfig, {"kl_stop": NAN}, "--kl-stop is nan, expected > 0"),
    (NetworkConfig, {"hidden_sizes": ()}, "--hidden-sizes is (), expected one or more sizes >= 1"),
    (NetworkConfig, {"hidden_sizes": (64, 0)}, "--hidden-sizes is (64, 0), expected one or more"),
    (NetworkConfig, {"log_std_init": NAN}, "--log-std-init is nan, expected a finite number"),
    (NetworkConfig, {"log_std_rate": 0.0}, "--log-std-rate is 0.0, expected > 0, or -1 for"),
    (NetworkConfig, {"log_std_rate": INF}, "--log-std-rate is inf, expected"),
]


@pytest.mark.parametrize(("group", "values", "sentence"), REFUSED)
def test_what_cannot_be_run_is_refused_with_a_sentence(group, values, sentence):
    with pytest.raises(ValueError, match=re.escape(sentence)):
        group(**values)


ACCEPTED = [
    (RolloutConfig, {"drop": 7}), (RolloutConfig, {"window": 64}),
    (RolloutConfig, {"slots": 4096}),
    (RolloutConfig, {"clip_obs": INF}), (ReturnsConfig, {"gamma": 1.0, "gamma_start": -1.0}),
    (ReturnsConfig, {"gamma": 0.0, "gae_lambda": 0.0}),
    (ReturnsConfig, {"lambda_ret": 0.0}), (SafetyConfig, {"variance_critic": False}),
    (SafetyConfig, {"variance_limit": 1.0, "psi": 0.5}), (UpdateConfig, {"max_grad_norm": INF}),
    (KlConfig, {"kl_stop": INF}), (KlConfig, {"kl_coef": 35.0}), (KlConfig, {"hinge_coef": 0.0}),
    (NetworkConfig, {"log_std_rate": -1.0}), (RunConfig, {"seed": 2**63 - 1}),
]  # fmt: skip


@pytest.mark.parametrize(("group", "values"), ACCEPTED)
def test_the_edge_of_what_can_be_run_is_accepted(group, values):
    assert all(getattr(group(**values), name) == value for name, value in values.items())


@pytest.mark.parametrize("name", ["num_minibatches", "critic_minibatches"])
def test_minibatches_must_divide_the_samples_of_a_slot(name):
    flag = name.replace("_", "-")
    sentence = f"--{flag} is 7, expected a divisor of the 256 samples of a slot"
    with pytest.raises(ValueError, match=re.escape(sentence)):
        Config.from_dict({"update": {name: 7}})


def test_settings_are_frozen():
    with pytest.raises(FrozenInstanceError):
        Config().run.seed = 3  # type: ignore[misc]


def test_counts_of_the_default():
    config = Config(rollout=RolloutConfig(drop=3))
    assert config.rollout.quorum == 5
    assert config.rollout.samples_per_slot == 4 * 64
    assert config.rollout.samples == 8 * 4 * 64
    assert config.update.policy_updates == 5 * 2
    assert config.update.critic_updates == config.update.updates == 10


def test_critics_may_have_their_own_counts():
    update = UpdateConfig(update_epochs=20, num_minibatches=1, critic_epochs=10)
    assert (update.policy_updates, update.critic_updates, update.updates) == (20, 10, 20)
    update = replace(update, critic_minibatches=4)
    assert (update.critic_slices, update.critic_updates, update.updates) == (4, 40, 40)


@pytest.mark.parametrize(("steps", "iterations"), [(1, 1), (2048, 1), (2049, 2), (1_000_000, 489)])
def test_steps_are_rounded_up_to_whole_iterations(steps, iterations):
    assert Config(run=RunConfig(total_timesteps=steps)).iterations == iterations


@pytest.mark.parametrize(
    ("lambda_ret", "gamma_bar", "discount"),
    [
        (-1.0, "paper", (0.5 * 0.75) ** 2),
        (1.0, "paper", 0.5**2),
        (0.0, "paper", 0.0),
        (-1.0, "authors-2019", 0.5 * 0.75),
        (0.25, "authors-2019", 0.5 * 0.25),
    ],
)
def test_the_discount_of_the_variance(lambda_ret, gamma_bar, discount):
    returns = ReturnsConfig(gamma=0.5, gae_lambda=0.75, lambda_ret=lambda_ret, gamma_bar=gamma_bar)
    assert returns.variance_discount == discount


def through_json(config):
    return Config.from_dict(json.loads(json.dumps(config.to_dict(), allow_nan=False)))


@pytest.mark.parametrize("preset", PRESETS)
def test_json_text_gives_the_same_config(preset):
    config = PRESETS[preset]("Hopper-v4")
    assert through_json(config) == config


def test_infinities_and_long_numbers_survive_json():
    config = Config(
        run=RunConfig(seed=2**63 - 1, env_kwargs='{"a": [1, "ψ"]}'),
        update=UpdateConfig(learning_rate=1 / 3, max_grad_norm=INF),
        network=NetworkConfig(hidden_sizes=(7,)),
    )
    assert config.to_dict()["update"]["max_grad_norm"] == "inf"
    assert through_json(config) == config


def test_what_a_file_leaves_out_is_the_default():
    assert Config.from_dict({}) == Config()
    assert Config.from_dict({"run": {"seed": 3}}) == Config(run=RunConfig(seed=3))


def test_whole_floats_are_whole_numbers_and_whole_numbers_are_floats():
    config = Config.from_dict({"run": {"total_timesteps": 1e6}, "safety": {"psi": 1}})
    assert (config.run.total_timesteps, config.safety.psi) == (1_000_000, 1.0)
    assert type(config.run.total_timesteps) is int
    assert type(config.safety.psi) is float


MISPLACED = [
    ({"rn": {}}, "found the group 'rn', expected tables named run, rollout, returns, safety"),
    ({"seed": 3}, "found the group 'seed', expected tables named run"),
    ({"run": 3}, "found the group 'run', expected tables named"),
    ({"run": {"sed": 3}}, "found the setting 'sed', expected one of env, env_kwargs, seed"),
    ({"run": {"seed": "3"}}, "seed is '3', expected a"),
    ({"run": {"seed": 1.5}}, "seed is 1.5, expected a"),
    ({"run": {"seed": True}}, "seed is True, expected a"),
    ({"run": {"seed": INF}}, "seed is inf, expected a"),
    ({"run": {"seed": NAN}}, "seed is nan, expected a"),
    ({"run": {"env": 3}}, "env is 3, expected a"),
    ({"safety": {"psi": "much"}}, "psi is 'much', expected a float such as 0.0"),
    ({"safety": {"psi": True}}, "psi is True, expected a"),
    ({"safety": {"psi": None}}, "psi is None, expected a"),
    ({"safety": {"psi": 10**400}}, "psi is 1000"),
    ({"safety": {"variance_critic": 1}}, "variance_critic is 1, expected a"),
    ({"network": {"hidden_sizes": [64, 3.5]}}, "hidden_sizes is [64, 3.5], expected a"),
    ({"network": {"hidden_sizes": 64}}, "hidden_sizes is 64, expected a"),
    ({"returns": {"gamma": 1.5}}, "--gamma is 1.5, expected 0 .. 1"),
]


@pytest.mark.parametrize(("values", "sentence"), MISPLACED)
def test_what_does_not_belong_into_a_file_is_named(values, sentence):
    with pytest.raises(ValueError, match=re.escape(sentence)):
        Config.from_dict(values)


CHOICES = [
    (group.name, name)
    for group in fields(Config)
    for name, hint in get_type_hints(type(getattr(Config(), group.name))).items()
    if get_origin(hint) is Literal
]


@pytest.mark.parametrize(("group", "name"), CHOICES)
def test_a_choice_that_does_not_exist_is_refused_by_name(group, name):
    known = get_args(get_type_hints(type(getattr(Config(), group)))[name])
    for choice in known:
        assert Config.from_dict({group: {name: choice}}).to_dict()[group][name] == choice
    with pytest.raises(ValueError, match=f"{name.replace('_', '.')} is '?nonsense"):
        Config.from_dict({group: {name: "nonsense"}})


short = st.text("ab1", max_size=3)
plain = st.none() | st.booleans() | st.integers() | st.floats() | short
values = plain | st.lists(plain, max_size=2) | st.dictionaries(short, plain)
places = st.sampled_from(
    [(group, name) for group, names in Config().to_dict().items() for name in names]
)


@settings(deadline=None, max_examples=100)
@given(places, values)
def test_any_value_anywhere_is_a_config_or_a_sentence(place, value):
    group, name = place
    try:
        config = Config.from_dict({group: {name: value}})
    except ValueError as error:
        assert name.replace("_", "-") in str(error).replace("_", "-")  # noqa: PT017
    else:
        assert through_json(config) == config
