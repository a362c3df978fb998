"""Exact V, Q and σ of a policy, by linear equations.

σ is the variance of the λ-return G^λ (Safe AC, eqs. 4, 5 and 8). Its recursion is exact when V is:
the expected product of δ and the later deviation is 0 (Lemma 1).
"""

from dataclasses import dataclass

import numpy as np

from dppo.four_rooms.mdp import Floats, Mdp


@dataclass(frozen=True, slots=True, kw_only=True)
class Exact:
    """What a policy is worth, and how much its return varies."""

    v: Floats  # [S]
    q: Floats  # [S, A]
    sigma: Floats  # [S]  σ(s) = Σ_a π(a|s) σ(s, a)
    sigma_sa: Floats  # [S, A]

    def objective(self, start: Floats, psi: float) -> float:
        """J = E[V(s_0) − ψ σ(s_0)] (eq. 9)."""
        return float(start @ (self.v - psi * self.sigma))


def value(mdp: Mdp, policy: Floats, gamma: float) -> tuple[Floats, Floats]:
    """V = r_π + γ P_π V, and Q(s, a) = E[r + γ V(s')]."""
    paid = np.einsum("sat,sat->sa", mdp.transition, mdp.reward)
    v = np.linalg.solve(
        np.eye(len(policy)) - gamma * mdp.under(policy), (policy * paid).sum(axis=1)
    )
    return v, paid + gamma * mdp.transition @ v


def evaluate(mdp: Mdp, policy: Floats, gamma: float, lambda_ret: float) -> Exact:
    """V, Q and σ with δ relative to V(s), so that σ(s) = Σ_a π(a|s) σ(s, a) is exact.

    σ(s, a) = E[δ² + γ̄ σ(s')], δ = r + γ V(s') − V(s), γ̄ = (γ λ_ret)². Eq. 10 squares the
    *expected* δ instead, relative to Q(s, a), which is 0 everywhere; the square belongs inside.
    """
    v, q = value(mdp, policy, gamma)
    delta = mdp.reward + gamma * v - v[:, None, None]
    square = np.einsum("sat,sat->sa", mdp.transition, delta**2 + mdp.noise)
    sigma, sigma_sa = _accumulate(mdp, policy, square, (gamma * lambda_ret) ** 2)
    return Exact(v=v, q=q, sigma=sigma, sigma_sa=sigma_sa)


def sarsa_fixed_point(mdp: Mdp, policy: Floats, gamma: float, lambda_ret: float) -> Exact:
    """Where Algorithm 1's critics come to rest under a fixed policy, in its SARSA form.

    σ(s, a) = E[δ² + γ̄ σ(s', a')], δ = r + γ Q(s', a') − Q(s, a): the variance of the return once a
    is chosen. The choice of the first action itself is left out: Σ_a π σ(s, a) is smaller than the
    variance of the return from s, by Var_a[Q(s, a)] where λ_ret is 1.
    """
    v, q = value(mdp, policy, gamma)
    choice = (policy * (q - v[:, None]) ** 2).sum(axis=1)  # Var[Q(s', a') | s']
    delta = mdp.reward + gamma * v - q[:, :, None]
    square = np.einsum("sat,sat->sa", mdp.transition, delta**2 + mdp.noise + gamma**2 * choice)
    sigma, sigma_sa = _accumulate(mdp, policy, square, (gamma * lambda_ret) ** 2)
    return Exact(v=v, q=q, sigma=sigma, sigma_sa=sigma_sa)


def _accumulate(
    mdp: Mdp, policy: Floats, square: Floats, gamma_bar: float
) -> tuple[Floats, Floats]:
    """σ(s) and σ(s, a): a value function whose reward is E[δ²] and whose discount is γ̄."""
    sigma = np.linalg.solve(
        np.eye(len(policy)) - gamma_bar * mdp.under(policy), (policy * square).sum(axis=1)
    )
    return sigma, square + gamma_bar * mdp.transition @ sigma
