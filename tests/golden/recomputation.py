"""What the reference makes of a recorded run.

Iterations are recomputed from the raw facts (observations, actions, rewards, flags) alone, with
the reference's own optimisers and its own statistics.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from dppo.gradients import Minibatches
from tests.golden import reference
from tests.golden import reference_networks as networks
from tests.golden.recorded_run import (
    CRITIC_RATE,
    ENVS,
    EPS,
    GAMMA,
    HIDDEN,
    ITERATIONS,
    LAMBDA,
    MAX_NORM,
    PSI,
    RATE,
    SLOTS,
    STD_RATE,
    STEPS,
    UPDATES,
    XI,
)


@dataclass
class Scales:
    """The statistics of all iterations so far, by concatenation."""

    returns: list[np.ndarray]
    sigma_targets: list[np.ndarray]
    running: np.ndarray
    """[slot, environment] discounted return of the episodes under way, raw"""

    @property
    def reward(self):
        return 1 / np.concatenate(self.returns).std() if self.returns else 1.0

    @property
    def sigma(self):
        if not self.sigma_targets:
            return (np.concatenate(self.returns).std() * self.reward) ** 2 if self.returns else 1.0
        return np.concatenate(self.sigma_targets).std() * self.reward**2


@dataclass
class Redone:
    """One iteration as the reference sees it."""

    scales: tuple[float, float]
    gradients: list[np.ndarray]
    """averaged, of each update"""
    parameters: list[np.ndarray]
    """before each update, and after the last"""
    hinges: list[float]
    """max(0, KL - 2 KL_target), the largest over the slots, of each update"""
    kl: float
    """mean over all samples after the last update"""
    critic_norms: list[float]


class Recomputation:
    def __init__(self, run):
        self.run, self.scales = run, Scales([], [], np.zeros((SLOTS, ENVS)))
        obs, out = run.spaces.obs_size, run.spaces.output_size
        box = run.spaces.action_kind == "box"
        self.policy = networks.Policy(
            networks.Mlp((obs, *HIDDEN, out)), () if box else run.spaces.action_sizes
        )
        self.critic = networks.Mlp((obs, *HIDDEN, 1))
        ends = np.cumsum([0, self.policy.size, self.critic.size, self.critic.size])
        self.parts = [slice(a, b) for a, b in pairwise(ends)]
        self.adams = [
            networks.Adam(self.policy.size, EPS),
            networks.Adam(self.critic.size, EPS),
            networks.Adam(self.critic.size, EPS),
        ]

    def redo(self, number):
        """One iteration, from the parameters it began with."""
        iteration, scales = self.run.iterations[number], self.scales
        start = iteration.parameters[0].astype(np.float64)
        estimates = [self._estimate(start, rollout) for rollout in iteration.rollouts]
        units = scales.reward, scales.sigma
        advantages = reference.combine(
            [flat(e.advantage) for e in estimates],
            [flat(e.variance_advantage) for e in estimates],
            PSI,
        )
        self._note(number, iteration.rollouts, estimates)
        kl = reference.Kl(iteration.collect.beta, XI, self.run.config.kl.kl_target)
        redone = Redone(units, [], [start], [], 0.0, [])
        minibatches = Minibatches(self.run.config, number)
        for update in range(UPDATES if number > 0 else 0):
            parts = [
                self._slot_gradient(
                    redone.parameters[-1], start, rollout, estimate, advantage,
                    minibatches.of(slot, update, ENVS * STEPS),
                    kl, units[1],
                )
                for slot, (rollout, estimate, advantage) in enumerate(
                    zip(iteration.rollouts, estimates, advantages, strict=True)
                )
            ]  # fmt: skip
            gradient = networks.average([p[0] for p in parts], [p[1] for p in parts])
            redone.gradients.append(gradient)
            redone.hinges.append(max(p[2] for p in parts))
            redone.critic_norms.append(float(np.linalg.norm(gradient[self.parts[1]])))
            redone.parameters.append(self._step(redone.parameters[-1], gradient, number))
        obs = np.concatenate([samples(r.obs) for r in iteration.rollouts])
        policy = self.parts[0]
        redone.kl = self.policy.kl(start[policy], redone.parameters[-1][policy], obs).mean()
        return redone

    def _estimate(self, parameters, rollout):
        """Advantages and targets of one slot, environments first."""
        _, value, variance = self.parts
        seen = [samples(rollout.obs), samples(rollout.next_obs)]
        v = [_back(self.critic.output(parameters[value], x)[:, 0]) for x in seen]
        sigma = [
            _back(reference.sigma(self.critic, parameters[variance], x, self.scales.sigma))
            for x in seen
        ]
        returns = self.run.config.returns
        return reference.estimate(
            reference.Steps(
                rollout.reward.T * self.scales.reward, rollout.terminated.T, rollout.ended.T
            ),
            reference.Critics(v[0], v[1], sigma[0], sigma[1]),
            reference.Discounts(
                GAMMA,
                LAMBDA,
                LAMBDA if returns.lambda_ret < 0 else returns.lambda_ret,
                returns.targets == "monte-carlo",
            ),
        )

    def _slot_gradient(
        self, parameters, start, rollout, estimate, advantage, rows, kl, sigma_scale
    ):
        """One slot's mean gradient, its samples, and how far its KL lies beyond the hinge."""
        policy, value, variance = self.parts
        assert rows.policy is not None
        obs, actions = samples(rollout.obs), samples(rollout.action)
        now, old = parameters[policy], start[policy]
        mine = (obs[rows.policy], actions[rows.policy], advantage[rows.policy])
        seen = obs[rows.critics]
        targets = flat(estimate.target)[rows.critics]
        variance_targets = flat(estimate.variance_target)[rows.critics]
        gradient = [
            reference.policy_gradient(self.policy, now, old, *mine, kl),
            reference.value_gradient(self.critic, parameters[value], seen, targets),
            reference.variance_gradient(
                self.critic, parameters[variance], seen, variance_targets, sigma_scale
            ),
        ]
        hinge = max(0.0, self.policy.kl(old, now, mine[0]).mean() - 2 * kl.target)
        return np.concatenate(gradient), len(rows.policy), hinge

    def _step(self, parameters, gradient, number):
        """Clip each network's gradient, and one Adam step each, at the linear schedule's rate."""
        factor = 1 - number / ITERATIONS
        policy_rates = np.full(self.policy.size, RATE)
        policy_rates[self.policy.net.size :] *= STD_RATE
        rates = [factor * policy_rates, factor * CRITIC_RATE, factor * CRITIC_RATE]
        return np.concatenate(
            [
                adam.step(parameters[part], networks.clipped(gradient[part], MAX_NORM), rate)
                for part, adam, rate in zip(self.parts, self.adams, rates, strict=True)
            ]
        )

    def _note(self, number, rollouts, estimates):
        """The iteration's discounted returns and targets of sigma, in raw reward."""
        scale = self.scales.reward
        targets = [flat(e.variance_target) / scale**2 for e in estimates]
        returns = []
        for slot, rollout in enumerate(rollouts):
            for t in range(STEPS):
                running = self.scales.running[slot]
                running[rollout.starts[t]] = 0.0
                running[:] = GAMMA * running + rollout.reward[t]
                returns.append(running.copy())
        self.scales.returns += returns
        if number > 0:  # those of the first iteration are in no unit
            self.scales.sigma_targets += targets


def samples(array):
    """[T, E, ...] as the minibatches count them: time first."""
    return array.reshape(STEPS * ENVS, -1).astype(np.float64)


def _back(column):
    """Samples as (E, T)."""
    return column.reshape(STEPS, ENVS).T


def flat(array):
    """(E, T) as samples."""
    return array.T.ravel()
