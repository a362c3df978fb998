"""The settings of Algorithm 1 (Safe AC), with symbol and unit; frozen and validated."""

from dataclasses import dataclass
from typing import Literal

from dppo.schedules import scheduled_psi
from dppo.settings import SafetyConfig, require, require_finite


@dataclass(frozen=True, slots=True, kw_only=True)
class AgentConfig:
    """One agent: what it learns from, and how fast. Defaults: Table 1, the row of ψ = 0.25."""

    psi: float = 0.25
    """ψ: weight of the variance of the return; 0: plain actor-critic [1/reward]."""
    update: Literal["sarsa", "printed", "expected"] = "sarsa"
    """Bootstrap on the next action (sarsa), max Q and min σ (printed), or the policy's mean."""
    alpha_theta: float = 0.01
    """α_θ: step size of the policy [1 per step]."""
    alpha_critic: float = 0.25
    """α_c: step size of Q [1 per step], 0..1."""
    alpha_sigma: float = 0.01
    """α_σ: step size of σ [1 per step], 0..1."""
    gamma: float = 0.99
    """γ: discount [per env step], 0..1."""
    lambda_ret: float = 0.99
    """λ of the return whose variance σ is; γ̄ = (γ λ)² [0..1]."""
    temperature: float = 0.05
    """Softmax over θ / temperature [unit of θ]."""
    inverse_temperature: bool = False
    """Keep the factor 1/temperature of ∇ log π, which the authors leave out."""
    baseline: bool = False
    """Subtract Σ_a π (Q − ψ σ) from the actor's Q − ψ σ."""
    occupancy: bool = False
    """Weigh the actor's Q by γ^t and its σ by γ̄^t, as eq. 15 does and Algorithm 1 does not."""
    psi_schedule: Literal["constant", "linear", "warmup"] = "constant"
    """ψ over the episodes: constant, linear from 0 to psi, or 0 for psi_warmup and then linear."""
    psi_warmup: float = 0.1
    """Fraction of the episodes with ψ = 0 in schedule warmup [0..1)."""

    def __post_init__(self) -> None:
        """Refuse what cannot learn."""
        rates = ("alpha_theta", "alpha_critic", "alpha_sigma")
        require_finite(self, "psi", "temperature", *rates)
        require(self.psi >= 0, "psi", self.psi, ">= 0")
        require(self.temperature > 0, "temperature", self.temperature, "> 0")
        require(self.alpha_theta > 0, "alpha_theta", self.alpha_theta, "> 0")
        for name in ("alpha_critic", "alpha_sigma"):
            require(0 < getattr(self, name) <= 1, name, getattr(self, name), "0 < rate <= 1")
        for name in ("gamma", "lambda_ret"):
            require(0 <= getattr(self, name) <= 1, name, getattr(self, name), "0 .. 1")
        require(0 <= self.psi_warmup < 1, "psi_warmup", self.psi_warmup, "0 <= psi_warmup < 1")

    @property
    def variance_discount(self) -> float:
        """γ̄ = (γ λ_ret)², the discount of the variance recursion (eq. 8)."""
        return (self.gamma * self.lambda_ret) ** 2

    @property
    def actor_step(self) -> float:
        """α_θ, times 1/temperature if ∇ log π keeps that factor."""
        return self.alpha_theta / (self.temperature if self.inverse_temperature else 1.0)

    def psi_at(self, progress: float) -> float:
        """ψ at `progress`: 0 in the first episode, 1 after the last."""
        safety = SafetyConfig(
            psi=self.psi, psi_schedule=self.psi_schedule, psi_warmup=self.psi_warmup
        )
        return scheduled_psi(safety, progress)
