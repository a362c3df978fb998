"""The gradient of eq. 15, and the exact gradient of the same objective.

Eq. 12 drops a term: it argues that E[∇δ] is 0, but what stands there is E[δ ∇δ], and
E[δ γ ∇V(s')] is a covariance. It is 0 where nothing that an action or chance decides changes the
next state, or where all next states are worth the same; elsewhere eq. 15 is an approximation.
"""

import numpy as np

from dppo.four_rooms.mdp import Floats, Mdp
from dppo.four_rooms.oracle import evaluate


def occupancy(mdp: Mdp, policy: Floats, discount: float) -> Floats:
    """[S] μ(s) = Σ_k discount^k P(s_k = s), from the start distribution."""
    ways = np.eye(len(policy)) - discount * mdp.under(policy).T
    return np.asarray(np.linalg.solve(ways, mdp.start), np.float64)


def eq15(mdp: Mdp, policy: Floats, *, psi: float, gamma: float, lambda_ret: float) -> Floats:
    """[S, A] μ(s) Q(s, a) − ψ μ̄(s) σ(s, a): the factor of ∇π(a|s) in eq. 15."""
    exact = evaluate(mdp, policy, gamma, lambda_ret)
    mu = occupancy(mdp, policy, gamma)
    mu_bar = occupancy(mdp, policy, (gamma * lambda_ret) ** 2)
    return mu[:, None] * exact.q - psi * mu_bar[:, None] * exact.sigma_sa


def exact(mdp: Mdp, policy: Floats, *, psi: float, gamma: float, lambda_ret: float) -> Floats:
    """[S, A] the same with what eq. 12 drops: −2 ψ γ Σ_s μ̄(s) E[δ ∇V(s')], through V."""
    delta_v = _leftover(mdp, policy, gamma, lambda_ret)
    value = np.linalg.solve(np.eye(len(policy)) - gamma * mdp.under(policy).T, delta_v)
    exact = evaluate(mdp, policy, gamma, lambda_ret)
    return (
        eq15(mdp, policy, psi=psi, gamma=gamma, lambda_ret=lambda_ret)
        - psi * value[:, None] * exact.q
    )


def _leftover(mdp: Mdp, policy: Floats, gamma: float, lambda_ret: float) -> Floats:
    """[S] the factor of ∇V(s') in 2 Σ_s μ̄(s) E[δ ∇δ]; that of ∇V(s) is E[δ | s] = 0."""
    v = evaluate(mdp, policy, gamma, lambda_ret).v
    delta = mdp.reward + gamma * v - v[:, None, None]
    mu_bar = occupancy(mdp, policy, (gamma * lambda_ret) ** 2)
    factor: Floats = np.einsum("s,sa,sat,sat->t", mu_bar, policy, mdp.transition, delta)
    return 2 * gamma * factor
