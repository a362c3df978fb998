"""The best policy under J = E[V(s_0) − ψ σ(s_0)] (eq. 9), by search over deterministic policies.

The variance of a return has no Bellman equation of optimality: what is best in one state depends
on what was decided in others (decision 0010). So candidates come from problems that do have one,
plain decision processes that pay r − κ Var[r] for several κ, and each is improved by exact local
search: all single changes of one action in one state are evaluated exactly, and the best is taken,
until none helps. Where the search ends, no single change helps; tests compare it with all policies
of small worlds.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dppo.four_rooms.mdp import Floats, Mdp
from dppo.four_rooms.oracle import evaluate, value

_CAUTION = (0.0, 0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 1.0)
"""κ: what a candidate pays for a unit of reward variance [1/reward]."""
_LEAST_GAIN = 1e-10
"""Smaller improvements are rounding, in units of |J| + 1."""


@dataclass(frozen=True, slots=True)
class Optimum:
    """A deterministic policy that no change of one action improves."""

    actions: NDArray[np.intp]  # [S]
    policy: Floats  # [S, A]  one-hot
    objective: float


def best(mdp: Mdp, *, psi: float, gamma: float, lambda_ret: float) -> Optimum:
    """The best policy that local search finds from all candidates."""
    found = (
        _improve(mdp, start, psi=psi, gamma=gamma, lambda_ret=lambda_ret)
        for start in _candidates(mdp, gamma)
    )
    return max(found, key=lambda optimum: optimum.objective)


def _candidates(mdp: Mdp, gamma: float) -> Iterator[NDArray[np.intp]]:
    """Optimal policies of the decision process that pays r − κ Var[r], each once."""
    seen = set()
    for caution in _CAUTION:
        careful = replace(mdp, reward=mdp.reward - caution * mdp.noise)
        actions = policy_iteration(careful, gamma)
        if actions.tobytes() not in seen:
            seen.add(actions.tobytes())
            yield actions


def policy_iteration(mdp: Mdp, gamma: float) -> NDArray[np.intp]:
    """[S] actions that maximise V in every state (Howard)."""
    actions = np.zeros(mdp.transition.shape[0], np.intp)
    here = np.arange(len(actions))
    while True:
        _, q = value(mdp, one_hot(actions, mdp), gamma)
        better = q.max(axis=1) > q[here, actions] + _LEAST_GAIN * (1 + abs(q).max())
        if not better.any():
            return actions
        actions = np.where(better, q.argmax(axis=1), actions)


def one_hot(actions: NDArray[np.intp], mdp: Mdp) -> Floats:
    """[S, A] the policy that takes these actions."""
    policy: Floats = np.eye(mdp.transition.shape[1])[actions]
    return policy


def _improve(
    mdp: Mdp, actions: NDArray[np.intp], *, psi: float, gamma: float, lambda_ret: float
) -> Optimum:
    """Take the best single change until none helps."""
    now = evaluate(mdp, one_hot(actions, mdp), gamma, lambda_ret).objective(mdp.start, psi)
    while True:
        after = single_changes(mdp, actions, psi=psi, gamma=gamma, lambda_ret=lambda_ret)
        state, action = np.unravel_index(after.argmax(), after.shape)
        if after[state, action] <= now + _LEAST_GAIN * (1 + abs(now)):
            return Optimum(actions, one_hot(actions, mdp), now)
        actions, now = actions.copy(), float(after[state, action])
        actions[state] = action


def single_changes(
    mdp: Mdp, actions: NDArray[np.intp], *, psi: float, gamma: float, lambda_ret: float
) -> Floats:
    """[S, A] J after changing the action of one state, exactly, for all states and actions.

    One row of P_π changes, so the inverse changes by a matrix of rank one (Sherman-Morrison):
    N' = N + N e_s x N / (1 − x N e_s), with x = discount (P' − P)_s.
    """
    gamma_bar, here = (gamma * lambda_ret) ** 2, np.arange(len(actions))
    ways, paid = mdp.transition, mdp.reward
    mean = (ways * paid).sum(axis=2)  # [S, A]  E[r]
    pay_squared = (ways * (paid**2 + mdp.noise)).sum(axis=2)  # [S, A]  E[r²]
    chosen = ways[here, actions]  # [S, S]  P_π
    inverse, inverse_bar = (
        np.linalg.inv(np.eye(len(actions)) - discount * chosen) for discount in (gamma, gamma_bar)
    )
    v = inverse @ mean[here, actions]
    q = mean + gamma * ways @ v
    moved = ways - chosen[:, None, :]  # [S, A, S]
    along = np.einsum("sat,ts->sa", moved, inverse)
    # [S, A, S]  V after each change
    v_after = v + inverse.T[:, None, :] * ((q - v[:, None]) / (1 - gamma * along))[:, :, None]

    # c(s) = E[δ²] = E[r²] + 2 γ E[r V(s')] + γ² E[V(s')²] − V(s)², as E[r + γ V(s')] = V(s)
    def squares(pay: Floats, way: Floats, weighted: Floats) -> Floats:
        own = v_after**2
        square: Floats = pay + 2 * gamma * v_after @ weighted.T + gamma**2 * own @ way.T - own
        return square

    weighted = ways * paid
    cost = squares(pay_squared[here, actions], chosen, weighted[here, actions])  # [S, A, S]
    cost[here, :, here] = (
        pay_squared
        + 2 * gamma * np.einsum("sat,sat->sa", weighted, v_after)
        + gamma**2 * np.einsum("sat,sat->sa", ways, v_after**2)
        - v_after[here, :, here] ** 2
    )
    mu_bar = mdp.start @ inverse_bar
    along_bar = np.einsum("sat,ts->sa", moved, inverse_bar)
    share = gamma_bar * mu_bar[:, None] / (1 - gamma_bar * along_bar)
    mu_after = mu_bar + share[:, :, None] * (moved @ inverse_bar)
    sigma = (mu_after * cost).sum(axis=2)
    objective: Floats = v_after @ mdp.start - psi * sigma
    return objective
