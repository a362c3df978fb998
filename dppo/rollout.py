"""Experience of one slot in one iteration: what happened, then what is learned from."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dppo.config import Config
from dppo.distributions import Distribution
from dppo.losses import AdvantageStatistics, softplus
from dppo.moments import FloatArray, Moments
from dppo.networks import Networks
from dppo.normalizer import Statistics
from dppo.returns import Estimate, estimate, estimate_variance, td_errors

Float32 = NDArray[np.float32]


@dataclass(frozen=True, slots=True, kw_only=True)
class Rollout:
    """T consecutive steps of E environments, several episodes if it comes to that."""

    obs: Float32  # [T, E, O]  s_t, normalised, with the time feature if there is one
    next_obs: Float32  # [T, E, O]  s_{t+1}; the *final* observation where an episode ended
    action: Float32  # [T, E, A]  unclipped
    reward: FloatArray  # [T, E]  r_t for leaving s_t, raw
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Experience:
    """One slot's iteration, ready for its updates. N = T · E samples in time order."""

    obs: Float32  # [N, O]
    action: Float32  # [N, A]
    output_old: Float32  # [N, K]  the policy's output before the updates
    log_std_old: Float32  # [A]
    log_prob_old: Float32  # [N]
    a_v: FloatArray  # [N]
    a_sigma: FloatArray  # [N]
    v_target: Float32  # [N]
    sigma_target: Float32  # [N]  in units of the variance network's output
    critic_obs: Float32  # [N or 2 N, O]  `obs`, with the previous iteration's if replayed


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
    rollout: Rollout,
    replay: Replay | None,
    networks: Networks,
    distribution: Distribution,
    parameters: Float32,
    statistics: Statistics,
    psi: float,
    config: Config,
) -> tuple[Experience, Replay, CriticFacts]:
    """Advantages, targets and π_old of a rollout, from the parameters that collected it."""
    scale, unit = statistics.reward_scale(config), statistics.sigma_unit(config)
    obs = rollout.obs.reshape(-1, rollout.obs.shape[-1])
    action = rollout.action.reshape(len(obs), -1)
    policy, log_std = networks.split_policy(parameters)
    output, _ = networks.policy.forward(policy, obs)

    v, value = _value(rollout, networks, parameters, scale, config)
    sigma, variance = _variance(rollout, value[0], networks, parameters, statistics, config)
    a_v, a_sigma = value[1].advantage.ravel(), variance.advantage.ravel()
    v_target, sigma_target = value[1].target.ravel(), variance.target.ravel()

    kept = Replay(obs=obs, v_target=v_target / scale, sigma_target=sigma_target / unit)
    critic_obs = obs
    if replay is not None:
        critic_obs = np.concatenate([obs, replay.obs])
        v_target = np.concatenate([v_target, replay.v_target * scale])
        sigma_target = np.concatenate([sigma_target, replay.sigma_target * unit])
    experience = Experience(
        obs=obs,
        action=action,
        output_old=output,
        log_std_old=log_std.copy(),
        log_prob_old=distribution.log_prob(output, log_std, action),
        a_v=a_v,
        a_sigma=a_sigma,
        v_target=v_target.astype(np.float32),
        sigma_target=(sigma_target / statistics.sigma_scale(config)).astype(np.float32),
        critic_obs=critic_obs,
    )
    raw_sigma = sigma / unit
    residual = value[1].target - v
    facts = CriticFacts(
        advantages=AdvantageStatistics.of(a_v, a_sigma, psi),
        fit=Moments.of(np.stack([value[1].target, residual, raw_sigma], -1).reshape(-1, 3)),
        sigma_target=Moments.of(kept.sigma_target),
        start_sigma=Moments.of(raw_sigma[rollout.starts]),
    )
    return experience, kept, facts


def _value(
    rollout: Rollout, networks: Networks, parameters: Float32, scale: float, config: Config
) -> tuple[FloatArray, tuple[FloatArray, Estimate]]:
    """V(s_t) [T, E]; the δ that feeds σ [T, E]; advantage and target of V."""
    part = parameters[networks.parts["value"]]
    shape = rollout.reward.shape

    def critic(x: Float32) -> FloatArray:
        output, _ = networks.value.forward(part, x.reshape(-1, x.shape[-1]))
        return output.astype(np.float64).reshape(shape)

    returns = config.returns
    v, v_next = critic(rollout.obs), critic(rollout.next_obs)
    delta, estimated = estimate(
        scale * rollout.reward,
        v,
        v_next,
        rollout.terminated,
        rollout.ended,
        discount=returns.gamma,
        trace=returns.gae_lambda,
        monte_carlo=returns.targets == "monte-carlo",
    )
    if returns.delta_reward == "raw":
        delta = td_errors(rollout.reward, v, v_next, rollout.terminated, returns.gamma)
    return v, (delta, estimated)


def _variance(
    rollout: Rollout,
    delta: FloatArray,
    networks: Networks,
    parameters: Float32,
    statistics: Statistics,
    config: Config,
) -> tuple[FloatArray, Estimate]:
    """σ(s_t) [T, E]; advantage and target of σ. All zero without a variance critic."""
    mlp = networks.variance
    if mlp is None:
        zero = np.zeros_like(delta)
        return zero, Estimate(zero, zero)
    part = parameters[networks.parts["variance"]]
    unit = statistics.sigma_scale(config)

    def critic(x: Float32) -> FloatArray:
        output, _ = mlp.forward(part, x.reshape(-1, x.shape[-1]))
        if config.safety.sigma_head == "softplus":
            output = softplus(output)
        return unit * output.astype(np.float64).reshape(delta.shape)

    sigma, sigma_next = critic(rollout.obs), critic(rollout.next_obs)
    return sigma, estimate_variance(
        delta, sigma, sigma_next, rollout.terminated, rollout.ended, config.returns
    )
