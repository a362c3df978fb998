"""What moves over a run: β, γ, ψ and the step sizes. Pure functions of the run's own figures."""

import math
from dataclasses import replace

from dppo.config import Config, KlConfig, SafetyConfig


def adapt_kl_coef(beta: float, kl: float, config: KlConfig, num_slots: int = 1) -> float:
    """β after an iteration that moved the policy by `kl` (Heess et al., Algorithms 1 and 3).

    KL > β_high KL_target: times α; KL < β_low KL_target: divided by α; then clamped.

    Args:
        beta: β so far.
        kl: mean KL[π_old‖π] at the iteration's end [nats].
        config: band, factor and clamp.
        num_slots: W when every slot moves the shared β in turn; then α is softened to
            α~ = 1 + (α − 1) / W.
    """
    factor = 1 + (config.kl_coef_scale - 1) / num_slots
    if kl > config.kl_high * config.kl_target:
        beta *= factor
    elif kl < config.kl_low * config.kl_target:
        beta /= factor
    return min(max(beta, config.kl_coef_min), config.kl_coef_max)


def scheduled_gamma(config: Config, iteration: int) -> float:
    """γ of an iteration: its horizon 1 / (1 − γ) goes geometrically from gamma_start's to gamma's.

    A short horizon first, since what comes at once is learned soonest; a long one at last, since a
    fall ends all that would have come (OpenAI Five lengthened its horizon so: Berner et al. 2019).
    """
    returns, progress = config.returns, iteration / config.iterations
    if returns.gamma_start < 0:
        return returns.gamma
    gap: float = (1 - returns.gamma_start) ** (1 - progress) * (1 - returns.gamma) ** progress
    return 1 - gap


def in_iteration(config: Config, iteration: int) -> Config:
    """The settings with the γ of an iteration."""
    gamma = scheduled_gamma(config, iteration)
    if gamma == config.returns.gamma:
        return config
    return replace(config, returns=replace(config.returns, gamma=gamma, gamma_start=-1.0))


def scheduled_psi(config: SafetyConfig, progress: float) -> float:
    """ψ at `progress` (0 at the start of the run, 1 at its end), without a variance limit."""
    match config.psi_schedule:
        case "constant":
            return config.psi
        case "linear":
            return config.psi * progress
        case "warmup":
            past = (progress - config.psi_warmup) / (1 - config.psi_warmup)
            return config.psi * max(0.0, past)


def dual_psi(psi: float, start_sigma: float, config: SafetyConfig) -> float:
    """ψ after a dual step on the constraint mean σ(s_0) <= limit: up when violated, down else.

    ψ ← max(0, ψ + rate (σ̄_0 / limit − 1)), each step at most `rate`, up as down: σ begins much too
    large, and what goes up sooner than it can come down stays up for most of a run.

    Args:
        psi: ψ so far.
        start_sigma: mean of σ(s_0) over the episodes begun in the iteration [reward²].
        config: limit and rate.
    """
    if math.isinf(config.variance_limit):
        return psi
    start_sigma = max(start_sigma, 0.0)  # a linear head may be below
    violation = min(start_sigma / config.variance_limit - 1, 1.0)
    return max(0.0, psi + config.variance_limit_rate * violation)


def learning_rate_factor(config: Config, iteration: int) -> float:
    """Factor of both step sizes at an iteration; never 0."""
    if config.update.lr_schedule == "linear":
        return 1 - iteration / config.iterations
    return 1.0


def adapt_servo(servo: float, beta: float, kl: float, config: KlConfig) -> float:
    """The paper's baseline: the policy's step size follows when β is near a clamp.

    β above 30/35 of its upper clamp while KL is too large: divided by 1.5 while above 0.1;
    below 35/30 of its lower clamp while KL is too small: times 1.5 while below 10.
    """
    too_far = kl > config.kl_high * config.kl_target and beta > config.kl_coef_max * 30 / 35
    too_near = kl < config.kl_low * config.kl_target and beta < config.kl_coef_min * 35 / 30
    if too_far and servo > 0.1:
        return servo / 1.5
    if too_near and servo < 10:
        return servo * 1.5
    return servo
