"""TD errors, advantages and targets, by hand and against closed forms."""

from itertools import product
from typing import Any

import numpy as np
import pytest

from dppo.config import ReturnsConfig
from dppo.returns import discounted_sums, estimate, estimate_variance, less_variable, td_errors

# Two environments, five steps, time down the page. Environment 0 terminates at t = 1 and is
# truncated at t = 3; environment 1 lives on; the window is cut at t = 1 and at t = 4. Numbers
# past a termination (9 and 8) must not count; past a truncation (4 and 4) and past a cut they do.
# All numbers are sums of powers of two: the results are exact.
REWARD = np.array([[1, 0], [2, 0], [0, 4], [1, 0], [4, 0]], float)
V = np.array([[2, 0], [1, 2], [2, 2], [0, 0], [1, 4]], float)
V_NEXT = np.array([[1, 2], [9, 2], [0, 0], [4, 4], [2, 8]], float)
SIGMA = np.array([[4, 0], [2, 0], [1, 4], [0, 0], [2, 0]], float)
SIGMA_NEXT = np.array([[2, 0], [8, 4], [0, 0], [4, 0], [8, 4]], float)
TERMINATED = np.array([[0, 0], [1, 0], [0, 0], [0, 0], [0, 0]], bool)
ENDED = np.array([[0, 0], [1, 1], [0, 0], [1, 0], [1, 1]], bool)
GAE = ReturnsConfig(gamma=0.5, gae_lambda=0.5, lambda_ret=1.0)
MONTE_CARLO = ReturnsConfig(gamma=0.5, gae_lambda=0.5, lambda_ret=1.0, targets="monte-carlo")


def _value(config):
    return estimate(
        REWARD, V, V_NEXT, TERMINATED, ENDED,
        discount=config.gamma, trace=config.gae_lambda,
        monte_carlo=config.targets == "monte-carlo",
    )  # fmt: skip


def _variance(config):
    delta, _ = _value(config)
    return estimate_variance(delta, SIGMA, SIGMA_NEXT, TERMINATED, ENDED, config)


def test_td_errors_stop_at_a_termination_and_bootstrap_at_a_truncation_and_a_cut():
    expected = [
        [1 + 0.5 * 1 - 2, 0 + 0.5 * 2 - 0],  # -0.5, 1
        [2 + 0 - 1, 0 + 0.5 * 2 - 2],  # terminated: 1; cut: -1
        [0 + 0.5 * 0 - 2, 4 + 0.5 * 0 - 2],  # -2, 2
        [1 + 0.5 * 4 - 0, 0 + 0.5 * 4 - 0],  # truncated, final observation worth 4: 3; 2
        [4 + 0.5 * 2 - 1, 0 + 0.5 * 8 - 4],  # cut: 4, 0
    ]
    np.testing.assert_array_equal(td_errors(REWARD, V, V_NEXT, TERMINATED, 0.5), expected)


def test_the_advantage_of_the_value_is_eq_20_and_its_target_the_lambda_return():
    _, estimated = _value(GAE)
    # gamma lambda = 1/4
    advantage: Any = [
        [-0.5 + 1 / 4, 1 - 1 / 4],
        [1, -1],
        [-2 + 3 / 4, 2 + 2 / 4 + 0 / 16],
        [3, 2 + 0 / 4],
        [4, 0],
    ]
    np.testing.assert_array_equal(estimated.advantage, advantage)
    np.testing.assert_array_equal(estimated.target, np.add(advantage, V))


def test_the_advantage_of_the_variance_is_eq_17_and_its_target_the_lambda_return():
    estimated = _variance(GAE)
    # gamma_bar = (0.5 * 1)^2 = 1/4; delta_sigma = delta^2 + sigma' / 4 - sigma
    #   environment 0: 1/4 + 2/4 - 4, 1 - 2, 4 + 0 - 1, 9 + 4/4 - 0, 16 + 8/4 - 2
    #   environment 1: 1 + 0 - 0, 1 + 4/4 - 0, 4 + 0 - 4, 4 + 0 - 0, 0 + 4/4 - 0
    # the trace is gamma_bar lambda = 1/8
    advantage: Any = [
        [-3.25 - 1 / 8, 1 + 2 / 8],
        [-1, 2],
        [3 + 10 / 8, 0 + 4 / 8 + 1 / 64],
        [10, 4 + 1 / 8],
        [16, 1],
    ]
    np.testing.assert_array_equal(estimated.advantage, advantage)
    np.testing.assert_array_equal(estimated.target, np.add(advantage, SIGMA))


def test_monte_carlo_targets_of_the_value_are_discounted_rewards_bootstrapped_at_the_cut():
    delta, estimated = _value(MONTE_CARLO)
    expected = [
        [1 + 2 / 2, 0 + 0 / 2 + 2 / 4],
        [2, 0 + 2 / 2],
        [0 + 1 / 2 + 4 / 4, 4 + 0 / 2 + 0 / 4 + 8 / 8],
        [1 + 4 / 2, 0 + 0 / 2 + 8 / 4],
        [4 + 2 / 2, 0 + 8 / 2],
    ]
    np.testing.assert_array_equal(estimated.target, expected)
    np.testing.assert_array_equal(estimated.advantage, _value(GAE)[1].advantage)
    np.testing.assert_array_equal(delta, _value(GAE)[0])


def test_monte_carlo_targets_of_the_variance_are_discounted_squares_of_delta():
    estimated = _variance(MONTE_CARLO)
    # delta^2: environment 0: 1/4, 1, 4, 9, 16; environment 1: 1, 1, 4, 4, 0
    expected = [
        [1 / 4 + 1 / 4, 1 + 1 / 4 + 4 / 16],
        [1, 1 + 4 / 4],
        [4 + 9 / 4 + 4 / 16, 4 + 4 / 4 + 0 / 16 + 4 / 64],
        [9 + 4 / 4, 4 + 0 / 4 + 4 / 16],
        [16 + 8 / 4, 0 + 4 / 4],
    ]
    np.testing.assert_array_equal(estimated.target, expected)
    np.testing.assert_array_equal(estimated.advantage, _variance(GAE).advantage)


def test_the_variance_critic_is_a_value_function_of_the_squared_td_error():
    delta, _ = _value(GAE)
    _, as_value = estimate(
        delta * delta, SIGMA, SIGMA_NEXT, TERMINATED, ENDED, discount=0.25, trace=0.5
    )
    np.testing.assert_array_equal(as_value.advantage, _variance(GAE).advantage)
    np.testing.assert_array_equal(as_value.target, _variance(GAE).target)


def test_discounted_sums_start_anew_after_every_end():
    sums = discounted_sums(np.ones((4, 1)), np.array([[False], [True], [False], [False]]), 0.5)
    np.testing.assert_array_equal(sums[:, 0], [1.5, 1, 1.5, 1])


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        (ReturnsConfig(gamma=0.5, gae_lambda=0.5), 0.0625),  # (0.5 * 0.5)^2, the paper's
        (ReturnsConfig(gamma=0.5, gae_lambda=0.5, lambda_ret=1.0), 0.25),  # the full return
        (ReturnsConfig(gamma=0.5, gae_lambda=1.0, lambda_ret=0.0), 0.0),
        (ReturnsConfig(gamma=0.5, gae_lambda=0.5, gamma_bar="authors-2019"), 0.25),
    ],
)
def test_gamma_bar_is_the_square_of_gamma_times_lambda_ret(settings, expected):
    assert settings.variance_discount == expected


# A chain of three states: stay, go on, or (from the last) end; rewards mean +- noise, fair coin.
STAY = 0.25
MEAN, NOISE = np.array([1.0, -2.0, 0.5]), np.array([0.5, 1.0, 2.0])
PROBABILITY = np.array([[STAY, 1 - STAY, 0], [0, STAY, 1 - STAY], [0, 0, STAY]])
GAMMA = 0.9
EXACT_V = np.linalg.solve(np.eye(3) - GAMMA * PROBABILITY, MEAN)


def _variance_of_lambda_return(lambda_ret):
    """E[G²] - V² with G = x + c G', x = r + gamma (1 - lambda) V(s'), c = gamma lambda.

    E[G²] = E[x²] + 2 c E[x V(s')] + c² E[G'²]: linear in E[G²], and no TD error in sight. Past
    the end V and G are 0, so the rows of PROBABILITY, which miss it, are enough. The noise is
    independent of s', so E[x²] = NOISE² + E[(MEAN + gamma (1 - lambda) V(s'))²].
    """
    own, traced = GAMMA * (1 - lambda_ret), GAMMA * lambda_ret
    x = MEAN[:, None] + own * EXACT_V[None, :]  # mean of x from s to s'
    ends = 1 - PROBABILITY.sum(axis=1)
    x_squared = NOISE**2 + (PROBABILITY * x**2).sum(axis=1) + ends * MEAN**2
    x_v = (PROBABILITY * x * EXACT_V[None, :]).sum(axis=1)
    second = np.linalg.solve(np.eye(3) - traced**2 * PROBABILITY, x_squared + 2 * traced * x_v)
    return second - EXACT_V**2


def _paths():
    """Every two-step path: pairs of (state, sign of the noise, next state, probability)."""
    steps = [
        (state, sign, after, p / 2)
        for state in range(3)
        for sign in (1, -1)
        for after, p in [(state, STAY), (state + 1, 1 - STAY)]
    ]
    # past the end (3) another episode begins in state 0
    return [(one, two) for one, two in product(steps, steps) if two[0] == one[2] % 3]


@pytest.mark.parametrize("lambda_ret", [1.0, 0.8])
@pytest.mark.parametrize("gae_lambda", [0.0, 0.95])
def test_on_a_chain_sigma_settles_at_the_variance_of_the_lambda_return(lambda_ret, gae_lambda):
    config = ReturnsConfig(gamma=GAMMA, gae_lambda=gae_lambda, lambda_ret=lambda_ret)
    states, signs, after, probability = np.moveaxis(np.array(_paths()), (0, 1, 2), (2, 1, 0))
    states, after, weight = states.astype(int), after.astype(int), probability.prod(axis=0)
    reward = MEAN[states] + signs * NOISE[states]
    terminated = after == 3
    ended = terminated | np.array([[False], [True]])
    v_at = np.append(EXACT_V, 99.0)  # 99: never to be read past the end
    delta = td_errors(reward, v_at[states], v_at[after], terminated, GAMMA)

    sigma = np.zeros(3)
    for _ in range(200):
        at = np.append(sigma, 99.0)
        target = estimate_variance(delta, at[states], at[after], terminated, ended, config).target
        sigma = np.bincount(states[0], weight * target[0], 3) / np.bincount(states[0], weight, 3)
    np.testing.assert_allclose(sigma, _variance_of_lambda_return(lambda_ret), rtol=1e-13)


def test_the_closed_form_in_the_last_state_of_the_chain_by_hand():
    # lambda_ret = 0: G = r + gamma V(s'), where s' is state 2 again with probability 1/4
    # Var = NOISE² + gamma² Var[V(s')]
    v = 0.5 / (1 - 0.9 * 0.25)
    expected = 2.0**2 + 0.9**2 * (0.25 * v**2 - (0.25 * v) ** 2)
    assert _variance_of_lambda_return(0.0)[2] == pytest.approx(expected, rel=1e-14)


def test_the_reward_of_trvo_by_hand():
    """κ = 1/2, y = 4: r = 2 gives 2 - 2 + 8 = 8, r = 4 gives 4 - 8 + 16 = 12, 0 gives 0."""
    judged = less_variable(np.array([[2.0, 4.0, 0.0]]), 4.0, 0.5)
    assert judged.tolist() == [[8.0, 12.0, 0.0]]


def test_the_mean_of_trvos_reward_is_the_mean_less_kappa_times_the_variance_and_a_constant():
    """With y the mean: E[r] - κ Var[r] + κ y²: of equal means the steadier one wins."""
    steady, wild = np.array([[3.0, 5.0]]), np.array([[0.0, 8.0]])
    for reward in (steady, wild):
        expected = 4.0 - 0.25 * reward.var() + 0.25 * 16
        assert less_variable(reward, 4.0, 0.25).mean() == expected
    assert less_variable(steady, 4.0, 0.25).mean() > less_variable(wild, 4.0, 0.25).mean()
