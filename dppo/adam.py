"""Adam on one flat float32 vector (Kingma and Ba 2015, Algorithm 1), as torch.optim.Adam."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class AdamState:
    """Moving averages of one network; replaced, never changed in place."""

    mean: Float32  # [P]  m
    square: Float32  # [P]  v
    updates: int
    """How many so far."""

    @classmethod
    def zero(cls, size: int) -> "AdamState":
        """Before the first update."""
        return cls(np.zeros(size, np.float32), np.zeros(size, np.float32), 0)


def adam(
    state: AdamState,
    gradient: Float32,
    rate: Float32 | float,
    *,
    beta1: float = 0.9,
    beta2: float = 0.999,
    eps: float = 1e-8,
) -> tuple[AdamState, Float32]:
    """One update.

    Args:
        state: before it.
        gradient: [P] of a loss that is minimised.
        rate: learning rate, or [P] learning rates.
        beta1, beta2, eps: as in the paper.

    Returns:
        The new state, and [P] what to add to the parameters.
    """
    updates = state.updates + 1
    mean = np.float32(beta1) * state.mean
    mean += np.float32(1 - beta1) * gradient
    square = np.float32(beta2) * state.square
    scale = gradient * gradient
    scale *= np.float32(1 - beta2)
    square += scale
    np.divide(square, np.float32(1 - beta2**updates), out=scale)
    np.sqrt(scale, out=scale)
    scale += np.float32(eps)
    change = mean / np.float32(1 - beta1**updates)  # unbiased
    change /= scale
    change *= -np.asarray(rate, np.float32)
    return AdamState(mean, square, updates), change


def clipped(gradient: Float32, max_norm: float) -> tuple[Float32, float]:
    """The gradient, shortened to `max_norm` if longer; and its norm before."""
    wide = gradient.astype(np.float64)
    wide *= wide
    norm = math.sqrt(wide.sum())
    if norm > max_norm:
        gradient = gradient * np.float32(max_norm / norm)
    return gradient, norm
