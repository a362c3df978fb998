"""β, ψ and step sizes over a run, worked out by hand."""

import math
from dataclasses import replace

import pytest

from dppo.config import (
    Config,
    KlConfig,
    ReturnsConfig,
    RolloutConfig,
    RunConfig,
    SafetyConfig,
    UpdateConfig,
)
from dppo.schedules import (
    adapt_kl_coef,
    adapt_servo,
    dual_psi,
    in_iteration,
    learning_rate_factor,
    scheduled_gamma,
    scheduled_psi,
)

KL = KlConfig(
    kl_target=0.25, kl_low=0.5, kl_high=2.0, kl_coef_scale=1.5, kl_coef_min=0.25, kl_coef_max=8.0
)
"""The band is 0.125 .. 0.5 nats."""


@pytest.mark.parametrize(
    ("beta", "kl", "after"),
    [
        (2.0, 0.6, 3.0),  # too far: times 1.5
        (3.0, 0.1, 2.0),  # too near: divided by 1.5
        (2.0, 0.3, 2.0),  # inside the band
        (2.0, 0.5, 2.0),  # on its upper edge
        (2.0, 0.125, 2.0),  # on its lower edge
        (6.0, 0.6, 8.0),  # 9, clamped
        (0.3, 0.0, 0.25),  # 0.2, clamped
    ],
)
def test_kl_coefficient_follows_the_kl(beta, kl, after):
    assert adapt_kl_coef(beta, kl, KL) == after


def test_kl_coefficient_moves_softly_when_every_slot_moves_it():
    # α~ = 1 + (1.5 - 1) / 4 = 1.125
    assert adapt_kl_coef(2.0, 0.6, KL, num_slots=4) == 2.25
    assert adapt_kl_coef(2.25, 0.1, KL, num_slots=4) == 2.0


def test_four_slots_moving_softly_stay_below_one_full_step():
    beta = 2.0
    for _ in range(4):
        beta = adapt_kl_coef(beta, 0.6, KL, num_slots=4)
    assert beta == pytest.approx(2.0 * 1.125**4, rel=1e-15)


def test_default_clamps_are_those_of_the_paper():
    config = KlConfig()
    beta = 1.0
    for _ in range(20):
        beta = adapt_kl_coef(beta, 1.0, config)
    assert beta == 35.0
    for _ in range(40):
        beta = adapt_kl_coef(beta, 0.0, config)
    assert beta == 1 / 35


@pytest.mark.parametrize(
    ("schedule", "at_start", "at_a_quarter", "at_half", "at_the_end"),
    [
        ("constant", 0.5, 0.5, 0.5, 0.5),
        ("linear", 0.0, 0.125, 0.25, 0.5),
        ("warmup", 0.0, 0.0, 0.5 / 3, 0.5),  # a quarter of nothing, then 3/4 up to ψ
    ],
)
def test_psi_over_the_run(schedule, at_start, at_a_quarter, at_half, at_the_end):
    config = SafetyConfig(psi=0.5, psi_schedule=schedule, psi_warmup=0.25)
    found = [scheduled_psi(config, progress) for progress in (0.0, 0.25, 0.5, 1.0)]
    assert found == pytest.approx([at_start, at_a_quarter, at_half, at_the_end], rel=1e-15)


def test_warmup_without_a_warmup_is_linear():
    config = SafetyConfig(psi=0.5, psi_schedule="warmup", psi_warmup=0.0)
    assert [scheduled_psi(config, p) for p in (0.0, 0.5, 1.0)] == [0.0, 0.25, 0.5]


LIMIT = SafetyConfig(psi=0.5, variance_limit=2.0, variance_limit_rate=0.125)


@pytest.mark.parametrize(
    ("psi", "start_sigma", "after"),
    [
        (0.5, 3.0, 0.5625),  # 50 % above the limit: up by 0.125 * 0.5
        (0.5, 1.0, 0.4375),  # 50 % below
        (0.5, 2.0, 0.5),  # on it
        (0.0, 0.0, 0.0),  # -0.125, but ψ is never negative
        (0.5, 1e9, 0.625),  # a violation counts as 1 at most: up by 0.125
        (0.5, -1e9, 0.375),  # and as -1 at least, also where σ's head is linear
    ],
)
def test_dual_step_of_psi(psi, start_sigma, after):
    assert dual_psi(psi, start_sigma, LIMIT) == after


def test_without_a_limit_psi_stays():
    assert dual_psi(0.3, 1e9, SafetyConfig()) == 0.3


SERVO = replace(KL, kl_coef_min=0.5, kl_coef_max=7.0, kl_coef=1.0)
"""β near its upper clamp is above 7 * 30/35 = 6, near its lower one below 0.5 * 35/30 = 0.583."""


@pytest.mark.parametrize(
    ("beta", "kl", "after"),
    [
        (6.5, 0.6, 2.0),  # β near the top and still too far: divided by 1.5
        (6.5, 0.3, 3.0),  # near the top, but inside the band
        (5.9, 0.6, 3.0),  # too far, but β has room
        (0.55, 0.1, 4.5),  # β near the bottom and still too near: times 1.5
        (0.55, 0.3, 3.0),
        (0.6, 0.1, 3.0),
        (0.55, 0.6, 3.0),  # too far while β is at the bottom is β's own business
    ],
)
def test_servo_moves_when_beta_cannot(beta, kl, after):
    assert adapt_servo(3.0, beta, kl, SERVO) == after


def test_servo_goes_down_to_a_tenth_and_no_further():
    servo = 1.0
    for _ in range(20):
        servo = adapt_servo(servo, 7.0, 1.0, SERVO)
    assert servo <= 0.1
    assert adapt_servo(0.1, 7.0, 1.0, SERVO) == 0.1


def test_servo_goes_up_to_ten_and_no_further():
    servo = 1.0
    for _ in range(20):
        servo = adapt_servo(servo, 0.5, 0.0, SERVO)
    assert servo >= 10
    assert adapt_servo(10.0, 0.5, 0.0, SERVO) == 10.0


def run_of(iterations, lr_schedule):
    rollout = RolloutConfig(slots=2, num_envs=1, num_steps=8)
    return Config(
        run=RunConfig(total_timesteps=16 * iterations), rollout=rollout,
        update=UpdateConfig(lr_schedule=lr_schedule),
    )  # fmt: skip


def test_linear_rates_fall_evenly_and_never_reach_zero():
    config = run_of(4, "linear")
    assert [learning_rate_factor(config, i) for i in range(4)] == [1.0, 0.75, 0.5, 0.25]


@pytest.mark.parametrize("schedule", ["constant", "servo"])
def test_other_rates_do_not_fall(schedule):
    config = run_of(4, schedule)
    assert [learning_rate_factor(config, i) for i in range(4)] == [1.0] * 4


def test_no_variance_limit_is_infinite():
    assert math.isinf(SafetyConfig().variance_limit)


def _growing(start, end):
    """Of 4 iterations."""
    return Config(
        run=RunConfig(total_timesteps=4 * 6),
        rollout=RolloutConfig(slots=2, num_envs=1, num_steps=3),
        update=UpdateConfig(num_minibatches=1),
        returns=ReturnsConfig(gamma=end, gamma_start=start),
    )


@pytest.mark.parametrize(
    ("start", "end", "gammas"),
    [
        (0.75, 0.984375, [0.75, 0.875, 0.9375, 0.96875, 0.984375]),  # horizons 4, 8, 16, 32, 64
        (0.0, 0.0, [0.0] * 5),
        (-1, 0.9, [0.9] * 5),
        (0.99, 0.9, [0.9] * 5),  # it never shrinks
    ],
)
def test_the_horizon_grows_geometrically(start, end, gammas):
    config = _growing(start, end)
    found = [scheduled_gamma(config, iteration) for iteration in range(5)]
    assert found == pytest.approx(gammas, abs=1e-15)


def test_a_start_that_nothing_grows_from_is_none():
    """One form for what is the same: such runs may go on with either."""
    assert ReturnsConfig(gamma=0.99, gamma_start=0.99) == ReturnsConfig(gamma=0.99)
    assert ReturnsConfig(gamma=0.99, gamma_start=0.995) == ReturnsConfig(gamma=0.99)
    assert ReturnsConfig(gamma_start=0.99) != ReturnsConfig(gamma_start=-1)


def test_the_settings_of_an_iteration_have_its_gamma_and_all_that_follows_from_it():
    config = in_iteration(_growing(0.75, 0.984375), 2)
    assert config.returns.gamma == pytest.approx(0.9375)
    assert config.returns.variance_discount == pytest.approx((0.9375 * 0.95) ** 2)
    assert in_iteration(config, 3) == config  # it moves no further
    plain = _growing(-1, 0.9)
    assert in_iteration(plain, 1) is plain
