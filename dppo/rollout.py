"""What happened in one iteration, and what is made of it for learning."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dppo.config import Config, SafetyConfig
from dppo.distributions import Distribution
from dppo.experience import Experience, critics_table
from dppo.losses import advantage_moments, sigma_of
from dppo.moments import FloatArray, Moments
from dppo.networks import Networks
from dppo.normalizer import Statistics
from dppo.returns import Estimate, estimate, estimate_variance, less_variable, td_errors

Float32 = NDArray[np.float32]


@dataclass(frozen=True, slots=True, kw_only=True)
class Rollout:
    """T consecutive steps of E environments, several episodes if it comes to that."""

    obs: Float32  # [T, E, O]  s_t, normalised, with the time feature if there is one
    next_obs: Float32  # [T, E, O]  s_{t+1}; the *final* observation where an episode ended
    action: Float32  # [T, E, A]  unclipped
    reward: FloatArray  # [T, E]  r_t for leaving s_t, unscaled
    terminated: NDArray[np.bool_]  # [T, E]  the task ended: V(s_{t+1}) is 0
    ended: NDArray[np.bool_]  # [T, E]  terminated, truncated, or the window was cut
    starts: NDArray[np.bool_]  # [T, E]  s_t is the first of an episode

    def __post_init__(self) -> None:
        """Refuse arrays that do not belong together."""
        shape = self.reward.shape
        for name in ("obs", "next_obs", "action", "terminated", "ended", "starts"):
            found = getattr(self, name).shape[:2]
            if found != shape:
                raise ValueError(f"{name} begins with shape {found}, reward has {shape}")

    def judged(self, mean_reward: float, config: SafetyConfig) -> "Rollout":
        """With the reward that is learned from, if that is not the environment's own."""
        weight = config.reward_variance
        if weight == 0:
            return self
        return replace(self, reward=less_variable(self.reward, mean_reward, weight))


@dataclass(frozen=True, slots=True, kw_only=True)
class Replay:
    """The previous iteration's critic samples of one slot, in raw reward units."""

    obs: Float32  # [N, O]
    v_target: FloatArray  # [N]
    sigma_target: FloatArray  # [N]


@dataclass(frozen=True, slots=True, kw_only=True)
class CriticFacts:
    """What the chief learns of one slot's estimates."""

    advantages: Moments  # [3]  A_V, A_σ, A_V − ψ A_σ
    fit: Moments  # [3]  target of V, target − V, σ in raw reward²
    sigma_target: Moments  # [1]  raw reward²
    start_sigma: Moments  # [1]  σ(s_0), raw reward²


def prepare(
    rollouts: Sequence[Rollout],
    replays: Sequence[Replay | None],
    networks: Networks,
    distribution: Distribution,
    parameters: Float32,
    statistics: Statistics,
    psi: float,
    config: Config,
) -> list[tuple[Experience, Replay, CriticFacts]]:
    """Advantages, targets and π_old of each slot's rollout, from the parameters of the rollout.

    Slots are computed side by side, [S, N, ...], each with the bits it would have alone.
    """
    obs = np.stack([_samples(rollout.obs) for rollout in rollouts])
    action = np.stack([_samples(rollout.action) for rollout in rollouts])
    policy, log_std = networks.split_policy(parameters)
    output, _ = networks.policy.forward(policy, obs)
    log_prob = distribution.log_prob(output, log_std, action)
    found = estimates(rollouts, obs, networks, parameters, statistics, config)
    return [
        _slot(
            rollout,
            replay,
            found.of(index),
            (obs[index], action[index], output[index], log_prob[index], log_std.copy()),
            statistics,
            psi,
            config,
        )
        for index, (rollout, replay) in enumerate(zip(rollouts, replays, strict=True))
    ]


def _samples(array: Float32) -> Float32:
    """[T, E, F] as [N, F]."""
    return array.reshape(-1, array.shape[-1])


@dataclass(frozen=True, slots=True)
class Estimates:
    """Of all slots side by side: [T, S, E]."""

    v: FloatArray
    value: Estimate
    sigma: FloatArray
    variance: Estimate

    def of(self, slot: int) -> "Estimates":
        """Of one slot: [T, E]."""
        return Estimates(
            self.v[:, slot],
            Estimate(self.value.advantage[:, slot], self.value.target[:, slot]),
            self.sigma[:, slot],
            Estimate(self.variance.advantage[:, slot], self.variance.target[:, slot]),
        )


def _slot(
    rollout: Rollout,
    replay: Replay | None,
    estimates: Estimates,
    acted: tuple[Float32, Float32, Float32, Float32, Float32],
    statistics: Statistics,
    psi: float,
    config: Config,
) -> tuple[Experience, Replay, CriticFacts]:
    """One slot's tables, what to keep for its next iteration, and what the chief is told."""
    obs, action, output, log_prob, log_std = acted
    scale, unit = statistics.reward_scale(config), statistics.sigma_unit(config)
    a_v, a_sigma = estimates.value.advantage.ravel(), estimates.variance.advantage.ravel()
    v_target, sigma_target = estimates.value.target.ravel(), estimates.variance.target.ravel()

    kept = Replay(obs=obs, v_target=v_target / scale, sigma_target=sigma_target / unit)
    critic_obs = obs
    if replay is not None:
        critic_obs = np.concatenate([obs, replay.obs])
        v_target = np.concatenate([v_target, replay.v_target * scale])
        sigma_target = np.concatenate([sigma_target, replay.sigma_target * unit])
    experience = Experience.of(
        obs=obs,
        action=action,
        output_old=output,
        log_std_old=log_std,
        log_prob_old=log_prob,
        a_v=a_v,
        a_sigma=a_sigma,
        critics=critics_table(critic_obs, v_target, sigma_target / statistics.sigma_scale(config)),
    )
    raw_sigma = estimates.sigma / unit
    target = estimates.value.target
    facts = CriticFacts(
        advantages=advantage_moments(a_v, a_sigma, psi),
        fit=Moments.of(np.stack([target, target - estimates.v, raw_sigma], -1).reshape(-1, 3)),
        sigma_target=Moments.of(kept.sigma_target),
        start_sigma=Moments.of(raw_sigma[rollout.starts]),
    )
    return experience, kept, facts


def estimates(
    rollouts: Sequence[Rollout],
    obs: Float32,
    networks: Networks,
    parameters: Float32,
    statistics: Statistics,
    config: Config,
) -> Estimates:
    """V, σ, and advantages and targets of both, for all slots, in the trainer's units.

    Args:
        rollouts: one per slot, all of one shape.
        obs: [S, N, O] their observations.
        networks, parameters, statistics, config: of the run.
    """
    next_obs = np.stack([_samples(rollout.next_obs) for rollout in rollouts])
    reward, terminated, ended = (
        np.stack([getattr(rollout, name) for rollout in rollouts], axis=1)
        for name in ("reward", "terminated", "ended")
    )

    def in_time(values: Float32) -> FloatArray:
        """[S, N] as [T, S, E]."""
        steps, slots, envs = reward.shape
        return values.astype(np.float64).reshape(slots, steps, envs).swapaxes(0, 1)

    v, v_next = (in_time(networks.critic("value", parameters, x)) for x in (obs, next_obs))
    scale, returns = statistics.reward_scale(config), config.returns
    delta, value = estimate(
        scale * reward,
        v,
        v_next,
        terminated,
        ended,
        discount=returns.gamma,
        trace=returns.gae_lambda,
        monte_carlo=returns.targets == "monte-carlo",
    )
    if not networks.has_variance:
        zero = np.zeros_like(delta)
        return Estimates(v, value, zero, Estimate(zero, zero))
    if returns.delta_reward == "raw":
        delta = td_errors(reward, v, v_next, terminated, returns.gamma)
    unit = statistics.sigma_scale(config)
    outputs = (networks.critic("variance", parameters, x) for x in (obs, next_obs))
    sigma, sigma_next = (unit * in_time(sigma_of(x, config.safety)) for x in outputs)
    variance = estimate_variance(delta, sigma, sigma_next, terminated, ended, returns)
    return Estimates(v, value, sigma, variance)
