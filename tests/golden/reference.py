"""Safe-DPPO in plain NumPy float64, written from the specification and the paper alone.

Nothing here imports `dppo`: a shared mistake would have to be made twice. Equation numbers are
those of Safe Actor-Critic. Arrays of one slot are (E, T): environments, steps. Networks,
distributions and the optimiser are in `reference_networks.py`.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tests.golden.reference_networks import Array, Mlp, Policy, log_softmax, sigmoid, softplus

Bools = NDArray[np.bool_]


# ---------------------------------------------------------------------------- returns


def gamma_bar(gamma: float, lambda_ret: float) -> float:
    """The discount of the variance (8)."""
    return (gamma * lambda_ret) ** 2


def td_errors(
    rewards: Array, values: Array, next_values: Array, terminated: Bools, discount: float
) -> Array:
    """r + discount V(s') - V(s); nothing follows a termination.

    `next_values` are the critic at the true next observation, also where an episode was cut.
    """
    errors = np.zeros_like(rewards)
    for e, t in np.ndindex(rewards.shape):
        future = 0.0 if terminated[e, t] else next_values[e, t]
        errors[e, t] = rewards[e, t] + discount * future - values[e, t]
    return errors


def trace_sum(terms: Array, ends: Bools, decay: float) -> Array:
    """sum_l decay^l term_{t+l}, up to and with the step that ends the episode or the window."""
    sums = np.zeros_like(terms)
    for e, t in np.ndindex(terms.shape):
        weight = 1.0
        for k in range(t, terms.shape[1]):
            sums[e, t] += weight * terms[e, k]
            if ends[e, k]:
                break
            weight *= decay
    return sums


@dataclass(frozen=True)
class Steps:
    """What happened in one slot."""

    rewards: Array
    """scaled"""
    terminated: Bools
    ends: Bools
    """terminated, truncated, or cut"""


@dataclass(frozen=True)
class Critics:
    """V and sigma before the iteration's updates, at s_t and at the true s_{t+1}."""

    values: Array
    next_values: Array
    sigmas: Array
    next_sigmas: Array


@dataclass(frozen=True)
class Discounts:
    """The three separate settings of section 2, and the kind of target."""

    gamma: float
    gae_lambda: float
    lambda_ret: float
    monte_carlo: bool = False


@dataclass(frozen=True)
class Estimates:
    """Advantages and targets of one slot, each (E, T)."""

    advantage: Array
    """A_V (20)"""
    variance_advantage: Array
    """A_sigma (17)"""
    target: Array
    """R_V"""
    variance_target: Array
    """R_sigma"""


def estimate(steps: Steps, critics: Critics, discounts: Discounts) -> Estimates:
    """Equations 16, 17, 20 and the targets A + V, A_sigma + sigma (or the sums of 19)."""
    gamma, trace = discounts.gamma, discounts.gae_lambda
    bar = gamma_bar(gamma, discounts.lambda_ret)
    deltas = td_errors(steps.rewards, critics.values, critics.next_values, steps.terminated, gamma)
    variance_deltas = td_errors(
        deltas**2, critics.sigmas, critics.next_sigmas, steps.terminated, bar
    )
    target_trace = 1.0 if discounts.monte_carlo else trace
    return Estimates(
        trace_sum(deltas, steps.ends, gamma * trace),
        trace_sum(variance_deltas, steps.ends, bar * trace),
        trace_sum(deltas, steps.ends, gamma * target_trace) + critics.values,
        trace_sum(variance_deltas, steps.ends, bar * target_trace) + critics.sigmas,
    )


def combine(advantages: list[Array], variance_advantages: list[Array], psi: float) -> list[Array]:
    """A_V - psi A_sigma, each standardised over the samples of all slots."""
    av, asigma = np.concatenate(advantages), np.concatenate(variance_advantages)
    std_v = av.std()
    std_sigma = max(asigma.std(), 1e-3 * std_v**2)
    return [
        (v - av.mean()) / std_v - psi * (s - asigma.mean()) / std_sigma
        for v, s in zip(advantages, variance_advantages, strict=True)
    ]


# -------------------------------------------------------------------------- objective


@dataclass(frozen=True)
class Kl:
    """The trust region of the objective."""

    beta: float
    xi: float
    target: float


def objective(
    policy: Policy, flat: Array, old: Array, obs: Array, actions: Array, advantages: Array, kl: Kl
) -> float:
    """J (21): the mean over the samples, to be maximised."""
    log_ratio = policy.log_probs(flat, obs, actions) - policy.log_probs(old, obs, actions)
    surrogate = (np.exp(log_ratio) * advantages).mean()
    mean_kl = policy.kl(old, flat, obs).mean()
    excess = max(0.0, mean_kl - 2 * kl.target)
    return float(surrogate - kl.beta * mean_kl - kl.xi * excess**2)


def policy_gradient(
    policy: Policy, flat: Array, old: Array, obs: Array, actions: Array, advantages: Array, kl: Kl
) -> Array:
    """d (-J) / d flat, by hand."""
    count = len(obs)
    log_ratio = policy.log_probs(flat, obs, actions) - policy.log_probs(old, obs, actions)
    mean_kl = policy.kl(old, flat, obs).mean()
    by_log_prob = (np.exp(log_ratio) * advantages / count)[:, None]
    by_kl = -(kl.beta + 2 * kl.xi * max(0.0, mean_kl - 2 * kl.target)) / count
    activations = policy.net.forward(flat[: policy.net.size], obs)
    before = policy.net.output(old[: policy.net.size], obs)
    if policy.choices:
        by_output = _categorical_slope(
            policy, before, activations[-1], actions, by_log_prob, by_kl
        )
        return policy.net.backward(flat, activations, -by_output)
    var_old, var_new = np.exp(2 * old[policy.net.size :]), np.exp(2 * flat[policy.net.size :])
    error, shift = actions - activations[-1], activations[-1] - before
    by_mean = by_log_prob * error / var_new + by_kl * shift / var_new
    by_log_std = by_log_prob * (error**2 / var_new - 1) + by_kl * (
        1 - (var_old + shift**2) / var_new
    )
    by_net = policy.net.backward(flat[: policy.net.size], activations, -by_mean)
    return np.concatenate([by_net, -by_log_std.sum(axis=0)])


def _categorical_slope(
    policy: Policy, before: Array, after: Array, actions: Array, by_log_prob: Array, by_kl: float
) -> Array:
    columns = []
    pairs = zip(policy.parts(before), policy.parts(after), strict=True)
    for component, (p_old, p_new) in enumerate(pairs):
        old, new = np.exp(log_softmax(p_old)), np.exp(log_softmax(p_new))
        one_hot = np.eye(new.shape[1])[actions[:, component].astype(int)]
        columns.append(by_log_prob * (one_hot - new) + by_kl * (new - old))
    return np.concatenate(columns, axis=1)


# ---------------------------------------------------------------------------- critics


def value_loss(net: Mlp, flat: Array, obs: Array, targets: Array) -> float:
    return float(((net.output(flat, obs)[:, 0] - targets) ** 2).mean())


def value_gradient(net: Mlp, flat: Array, obs: Array, targets: Array) -> Array:
    activations = net.forward(flat, obs)
    error = activations[-1][:, 0] - targets
    return net.backward(flat, activations, (2 * error / len(obs))[:, None])


def sigma(net: Mlp, flat: Array, obs: Array, scale: float) -> Array:
    """Variance of the return, in squared units of the scaled reward."""
    return scale * softplus(net.output(flat, obs)[:, 0])


def variance_loss(net: Mlp, flat: Array, obs: Array, targets: Array, scale: float) -> float:
    """In standardised units: the network regresses target / scale."""
    return float(((softplus(net.output(flat, obs)[:, 0]) - targets / scale) ** 2).mean())


def variance_gradient(net: Mlp, flat: Array, obs: Array, targets: Array, scale: float) -> Array:
    activations = net.forward(flat, obs)
    z = activations[-1][:, 0]
    error = softplus(z) - targets / scale
    return net.backward(flat, activations, (2 * error * sigmoid(z) / len(obs))[:, None])
