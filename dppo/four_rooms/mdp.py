"""A small Markov decision process as arrays: what the exact oracle works on.

S states, A actions. A terminal state has no way out: its rows of `transition` are 0, so that its
value is 0 without a special case.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Mdp:
    """Probabilities, and the first two moments of the rewards."""

    transition: Floats  # [S, A, S]  P(s'|s, a)
    reward: Floats  # [S, A, S]  E[r | s, a, s']
    noise: Floats  # [S, A, S]  Var[r | s, a, s']
    start: Floats  # [S]  d, the distribution of s_0

    def __post_init__(self) -> None:
        """Refuse arrays that are no decision process."""
        states, actions, _ = self.transition.shape
        for name in ("transition", "reward", "noise"):
            shape = getattr(self, name).shape
            if shape != (states, actions, states):
                raise ValueError(
                    f"{name} has shape {shape}, expected {(states, actions, states)}: "
                    "states, actions, next states"
                )
        ways = self.transition.sum(axis=2)
        if not (np.isclose(ways, 1) | (ways == 0)).all():
            raise ValueError("each row of transition has to sum to 1, or to 0 in a terminal state")
        if self.start.shape != (states,) or not np.isclose(self.start.sum(), 1):
            raise ValueError(f"start has to be a distribution over the {states} states")

    def under(self, policy: Floats) -> Floats:
        """[S, S] P_π: transition probabilities under `policy` [S, A]."""
        under: Floats = np.einsum("sa,sat->st", policy, self.transition)
        return under

    @property
    def uniform(self) -> Floats:
        """[S, A] the policy that takes every action equally often."""
        return np.full(self.transition.shape[:2], 1 / self.transition.shape[1])
