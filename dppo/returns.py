"""Advantages and targets, for the value and for the variance through the same two functions.

Conventions of this file: time is the first axis, t = 0 .. T-1; environments the second, E of
them. `reward[t]` is received for leaving s_t (Sutton and Barto's R_{t+1}); `v[t]` = V(s_t) and
`v_next[t]` = V(s_{t+1}), where s_{t+1} is the *final* observation if the episode ended at t.
Everything is float64.

    terminated  the task is over: the value past it is 0
    ended       terminated, truncated, or the window was cut: sums over time stop here
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dppo.config import ReturnsConfig

Values = NDArray[np.float64]
Flags = NDArray[np.bool_]


def less_variable(reward: Values, mean: float, weight: float) -> Values:
    """What TRVO learns from: r' = r − κ r² + 2 κ r y = r − κ (r − y)² + κ y².

    y is the mean reward of a step. Bisi et al. 2020, *Risk-averse trust region
    optimization for reward-volatility reduction*: the policy that earns most of r' gives up some
    reward for rewards that vary less from step to step. A baseline, no part of Safe Actor-Critic.

    Args:
        reward: [T, E] r_t, raw.
        mean: y, over all steps of the iteration before.
        weight: κ > 0 [1/reward]; Bisi et al. call it λ, others c.
    """
    return reward - weight * np.square(reward) + 2 * weight * mean * reward


def td_errors(
    reward: Values, v: Values, v_next: Values, terminated: Flags, discount: float
) -> Values:
    """δ_t = r_t + γ V(s_{t+1}) − V(s_t), with V = 0 past a termination.

    A truncated step is not a terminated one: its V(s_{t+1}) still counts.

    Args:
        reward, v, v_next: [T, E].
        terminated: [T, E].
        discount: γ, per environment step.

    Returns:
        [T, E] temporal-difference errors.
    """
    return reward + discount * np.where(terminated, 0.0, v_next) - v


def discounted_sums(values: Values, ended: Flags, discount: float) -> Values:
    """S_t = x_t + d S_{t+1}, starting anew after every end: sum over l of d^l x_{t+l}.

    With x = δ and d = γλ this is the generalised advantage (Schulman et al. 2015, eq. 16;
    Safe Actor-Critic, eq. 20).

    Args:
        values: [T, E] x_t.
        ended: [T, E] the sum of step t stops at t.
        discount: d, per environment step.

    Returns:
        [T, E] sums.
    """
    keep = np.where(ended, 0.0, discount)
    sums = np.empty_like(values)
    later = np.zeros(values.shape[1:])
    for t in range(len(values) - 1, -1, -1):
        later = values[t] + keep[t] * later
        sums[t] = later
    return sums


@dataclass(frozen=True, slots=True)
class Estimate:
    """Advantage and target of one critic."""

    advantage: Values  # [T, E]
    target: Values  # [T, E]  what the critic regresses on


def estimate(
    reward: Values,
    v: Values,
    v_next: Values,
    terminated: Flags,
    ended: Flags,
    *,
    discount: float,
    trace: float,
    monte_carlo: bool = False,
) -> tuple[Values, Estimate]:
    """One critic's TD errors, advantage and target; the value and the variance critic alike.

    A = sum_l (discount · trace)^l δ_{t+l}  (eq. 20), target = A + v, the λ-return.
    With `monte_carlo` the target is the discounted sum to the end, bootstrapped at a cut (eq. 19),
    which is the same expression with trace 1.

    Returns:
        δ [T, E], and the estimate.
    """
    delta = td_errors(reward, v, v_next, terminated, discount)
    advantage = discounted_sums(delta, ended, discount * trace)
    to_the_end = discounted_sums(delta, ended, discount) if monte_carlo else advantage
    return delta, Estimate(advantage, to_the_end + v)


def estimate_variance(
    delta: Values,
    sigma: Values,
    sigma_next: Values,
    terminated: Flags,
    ended: Flags,
    config: ReturnsConfig,
) -> Estimate:
    """A_σ and the target of σ (Safe Actor-Critic, eq. 16, 17, 19).

    σ(s) = E[δ² + γ̄ σ(s')] is a value function whose reward is δ² and whose discount is γ̄, so it
    goes through the same estimator; the trace of A_σ is γ̄λ (eq. 17).
    """
    _, estimated = estimate(
        np.square(delta),
        sigma,
        sigma_next,
        terminated,
        ended,
        discount=config.variance_discount,
        trace=config.gae_lambda,
        monte_carlo=config.targets == "monte-carlo",
    )
    return estimated
