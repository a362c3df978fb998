"""Action distributions: log-probability, KL, and their gradients with respect to what the
network puts out.

Shape letters: N samples · A action size · K output size (A means, or all logits).
Axes before N (slots side by side) pass through.
`output` is what the policy network returns, [N, K]; `log_std` is [A], and empty for categorical
policies. Kullback-Leibler is always KL[π_old‖π], summed over action dimensions, per state.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dppo.spaces import Spaces

Float32 = NDArray[np.float32]
Gradient = tuple[Float32, Float32]
"""([N, K] with respect to the output, [N, A] with respect to log_std)."""


def mean_std(log_std: Float32) -> float | None:
    """Standard deviation of actions, mean over their dimensions; None: actions are choices."""
    return float(np.exp(log_std).mean()) if log_std.size else None


@dataclass(frozen=True, slots=True)
class DiagonalGaussian:
    """Independent normals: mean from the network, log std a free parameter."""

    action_size: int
    """A."""

    def noise(self, rng: np.random.Generator, shape: tuple[int, ...]) -> Float32:
        """Standard normal draws [*shape, A]."""
        return rng.standard_normal((*shape, self.action_size), np.float32)

    def scaled(self, noise: Float32, log_std: Float32) -> Float32:
        """Noise times std [..., A], for `sample`: of many steps at once."""
        scaled: Float32 = np.exp(log_std) * noise
        return scaled

    def sample(self, output: Float32, scaled: Float32) -> Float32:
        """Actions [N, A] = mean + std · noise. Unclipped: the environment's border clips."""
        return output + scaled

    def mode(self, output: Float32) -> Float32:
        """The most likely actions [N, A]."""
        return output

    def log_prob(self, output: Float32, log_std: Float32, action: Float32) -> Float32:
        """Log π(a|s) [N] of the unclipped action."""
        z = (action - output) * np.exp(-log_std)
        constant = log_std.sum() + np.float32(0.5 * math.log(2 * math.pi) * self.action_size)
        log_prob: Float32 = np.float32(-0.5) * np.square(z).sum(axis=-1) - constant
        return log_prob

    def log_prob_gradient(self, output: Float32, log_std: Float32, action: Float32) -> Gradient:
        """∂ log π / ∂ mean = z / std,  ∂ log π / ∂ log std = z² − 1."""
        inverse = np.exp(-log_std)
        z = (action - output) * inverse
        return z * inverse, z * z - 1

    def kl(self, old: Float32, old_log_std: Float32, output: Float32, log_std: Float32) -> Float32:
        """KL[π_old‖π] [N]."""
        shift = (old - output) * np.exp(-log_std)
        ratio = np.exp(2 * (old_log_std - log_std))
        per_dimension = log_std - old_log_std + np.float32(0.5) * (shift * shift + ratio - 1)
        kl: Float32 = per_dimension.sum(axis=-1)
        return kl

    def kl_gradient(
        self, old: Float32, old_log_std: Float32, output: Float32, log_std: Float32
    ) -> Gradient:
        """∂KL/∂ mean = −shift / std,  ∂KL/∂ log std = 1 − shift² − (std_old / std)²."""
        inverse = np.exp(-log_std)
        shift = (old - output) * inverse
        return -shift * inverse, 1 - shift * shift - np.exp(2 * (old_log_std - log_std))


@dataclass(frozen=True, slots=True)
class Categorical:
    """Independent categoricals over the components of a discrete action."""

    sizes: tuple[int, ...]
    """Choices of each component; one entry for Discrete."""

    def noise(self, rng: np.random.Generator, shape: tuple[int, ...]) -> Float32:
        """Gumbel draws [*shape, K]."""
        uniform = rng.random((*shape, sum(self.sizes)))
        return (-np.log(-np.log(np.maximum(uniform, 1e-300)))).astype(np.float32)

    def scaled(self, noise: Float32, log_std: Float32) -> Float32:  # noqa: ARG002
        """The noise as it is: nothing scales it."""
        return noise

    def sample(self, output: Float32, scaled: Float32) -> Float32:
        """Actions [N, A], whole numbers: the largest logit + Gumbel noise wins."""
        return self.mode(output + scaled)

    def mode(self, output: Float32) -> Float32:
        """The most likely actions [N, A], whole numbers."""
        best = [part.argmax(axis=-1) for part in self._parts(output)]
        return np.stack(best, axis=-1).astype(np.float32)

    def log_prob(self, output: Float32, log_std: Float32, action: Float32) -> Float32:  # noqa: ARG002
        """Log π(a|s) [N], summed over components."""
        chosen = np.zeros(output.shape[:-1], np.float32)
        for column, part in enumerate(self._parts(self._log_softmax(output))):
            index = action[..., column, None].astype(np.int64)
            chosen += np.take_along_axis(part, index, axis=-1)[..., 0]
        return chosen

    def log_prob_gradient(self, output: Float32, log_std: Float32, action: Float32) -> Gradient:
        """∂ log π / ∂ logits = onehot(a) − π."""
        gradient = -np.exp(self._log_softmax(output))
        index = np.array(self._starts()) + action.astype(np.int64)
        np.put_along_axis(
            gradient, index, np.take_along_axis(gradient, index, axis=-1) + 1, axis=-1
        )
        return gradient, np.empty((*output.shape[:-1], log_std.size), np.float32)

    def kl(
        self,
        old: Float32,
        old_log_std: Float32,  # noqa: ARG002
        output: Float32,
        log_std: Float32,  # noqa: ARG002
    ) -> Float32:
        """KL[π_old‖π] = sum of π_old (log π_old − log π) [N]."""
        old_log = self._log_softmax(old)
        kl: Float32 = (np.exp(old_log) * (old_log - self._log_softmax(output))).sum(axis=-1)
        return kl

    def kl_gradient(
        self,
        old: Float32,
        old_log_std: Float32,  # noqa: ARG002
        output: Float32,
        log_std: Float32,
    ) -> Gradient:
        """∂KL/∂ logits = π − π_old."""
        gradient = np.exp(self._log_softmax(output)) - np.exp(self._log_softmax(old))
        return gradient, np.empty((*output.shape[:-1], log_std.size), np.float32)

    def _starts(self) -> list[int]:
        return [sum(self.sizes[:index]) for index in range(len(self.sizes))]

    def _parts(self, output: Float32) -> list[Float32]:
        return [
            output[..., start : start + size]
            for start, size in zip(self._starts(), self.sizes, strict=True)
        ]

    def _log_softmax(self, output: Float32) -> Float32:
        parts = []
        for part in self._parts(output):
            shifted = part - part.max(axis=-1, keepdims=True)
            parts.append(shifted - np.log(np.exp(shifted).sum(axis=-1, keepdims=True)))
        return np.concatenate(parts, axis=-1)


Distribution = DiagonalGaussian | Categorical


def distribution_of(spaces: Spaces) -> Distribution:
    """The distribution that fits an action space."""
    if spaces.action_kind == "box":
        return DiagonalGaussian(spaces.action_size)
    return Categorical(spaces.action_sizes)
