"""The objective (maximised), the two losses (minimised), and their derivatives.

    J = mean[ratio · A] − β KL[π_old‖π] − ξ max(0, KL − 2 KL_target)²
    A = A_V − ψ A_σ                                          (Safe Actor-Critic, eq. 21)

The paper sums over t; the mean keeps β and ξ independent of the number of samples.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dppo.config import KlConfig, SafetyConfig
from dppo.moments import FloatArray, Moments

Float32 = NDArray[np.float32]
_LEAST = 1e-30


def policy_objective(gain: Float32, kl: FloatArray, beta: float, config: KlConfig) -> FloatArray:
    """J [S] of some sets of samples (eq. 21).

    Args:
        gain: [S, N] ratio · A, with ratio = π(a|s) / π_old(a|s) and A = A_V − ψ A_σ.
        kl: [S] mean KL[π_old‖π] over the samples [nats].
        beta: β.
        config: KL_target and ξ.
    """
    objective: FloatArray = (
        np.mean(gain.astype(np.float64), axis=-1)
        - beta * kl
        - config.hinge_coef * np.square(np.maximum(0.0, kl - 2 * config.kl_target))
    )
    return objective


def kl_weight(kl: FloatArray, beta: float, config: KlConfig) -> FloatArray:
    """−∂J/∂KL [S] = β + 2 ξ max(0, KL − 2 KL_target)."""
    weight: FloatArray = beta + 2 * config.hinge_coef * np.maximum(0.0, kl - 2 * config.kl_target)
    return weight


def softplus(x: Float32) -> Float32:
    """log(1 + e^x), without overflow."""
    result: Float32 = np.maximum(x, 0) + np.log1p(np.exp(-np.abs(x)))
    return result


def sigma_of(output: Float32, config: SafetyConfig) -> Float32:
    """σ, in units of the variance network's output, from that output."""
    return softplus(output) if config.sigma_head == "softplus" else output


def softplus_derivative(x: Float32) -> Float32:
    """1 / (1 + e^−x), without overflow."""
    small: Float32 = np.exp(-np.abs(x))
    return np.divide(np.where(x >= 0, 1, small), 1 + small, dtype=np.float32)


def advantage_moments(a_v: FloatArray, a_sigma: FloatArray, psi: float) -> Moments:
    """Moments [3] of (A_V, A_σ, A_V − ψ A_σ) over one slot's advantages, each [N]."""
    return Moments.of(np.stack([a_v, a_sigma, a_v - psi * a_sigma], axis=1))


@dataclass(frozen=True, slots=True)
class AdvantageStatistics:
    """Of the samples of all slots: `advantage_moments`, merged."""

    moments: Moments  # [3]

    @property
    def stds(self) -> tuple[float, float, float]:
        """Standard deviations; that of A_σ is at least a thousandth of that of A_V, squared.

        Both are reward² (unless raw rewards feed δ of σ), so this floor has no unit. Without it, a
        variance that is all but zero would be blown up to unit size.
        """
        v, _, joint = (float(std) for std in self.moments.std())
        sigma = float(self.moments.std(floor=_LEAST)[1])  # reward²: far below what rewards can be
        return v, max(sigma, 1e-3 * v * v), joint


def combine(
    a_v: FloatArray,
    a_sigma: FloatArray,
    psi: float,
    statistics: AdvantageStatistics,
    config: SafetyConfig,
) -> Float32:
    """A = A_V − ψ A_σ, standardised over the samples of all slots as `adv_norm` says.

    separate: each standardised, their sum not again (what the paper's ψ values mean);
    joint: the sum standardised; none: as it is. With ψ = 0 all three are plain DPPO.
    """
    mean_v, mean_sigma, mean_joint = (float(mean) for mean in statistics.moments.mean)
    std_v, std_sigma, std_joint = statistics.stds
    match config.adv_norm:
        case "separate":
            safe = (a_v - mean_v) / std_v
            if psi != 0:
                safe = safe - psi * ((a_sigma - mean_sigma) / std_sigma)
        case "joint":
            safe = ((a_v - psi * a_sigma) - mean_joint) / std_joint
        case "none":
            safe = a_v - psi * a_sigma
    return safe.astype(np.float32)
