"""How an environment fails, from the row of a vector up to the slot."""

import numpy as np

from dppo.errors import RunFailedError
from workers.kinds.kind import Float64, are_finite


class RowFailedError(Exception):
    """A row of a vector environment raised, or returned what does not fit."""

    def __init__(self, row: int, what: str) -> None:
        super().__init__(f"environment {row} {what}")
        self.row, self.what = row, what


class EnvironmentFailedError(Exception):
    """An environment raised, or returned what is not a number; slot, environment, step named."""

    def __init__(self, slot: int, reason: str) -> None:
        super().__init__(reason)
        self.slot = slot


def failed_episode(name: str, what: str, step: int, seed: int) -> RunFailedError:
    """The sentence for an episode that nobody learns from: where it failed, and how to see it."""
    return RunFailedError(f"{name} {what} at step {step} of an episode with reset seed {seed}")


def odd_row(obs: Float64, reward: Float64) -> int | None:
    """The first row of [n, O] and [n] of which a number is not finite; None: all are."""
    if are_finite(obs) and are_finite(reward):
        return None
    finite = np.isfinite(obs).all(axis=1) & np.isfinite(reward)
    return int(np.flatnonzero(~finite)[0])
