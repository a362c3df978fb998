"""Networks, distributions and the optimiser of the reference, in plain NumPy float64.

Nothing here imports `dppo`: see `reference.py`. Networks and parameters are flat vectors:
[W1 (in x out, row-major), b1, W2, b2, ... | log_std].
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


# --------------------------------------------------------------------------- networks


@dataclass(frozen=True)
class Mlp:
    """Linear layers with tanh between them."""

    sizes: tuple[int, ...]

    @property
    def size(self) -> int:
        return sum(i * o + o for i, o in zip(self.sizes[:-1], self.sizes[1:], strict=True))

    def layers(self, flat: Array) -> list[tuple[Array, Array]]:
        layers, at = [], 0
        for fan_in, fan_out in zip(self.sizes[:-1], self.sizes[1:], strict=True):
            weight = flat[at : at + fan_in * fan_out].reshape(fan_in, fan_out)
            at += fan_in * fan_out
            layers.append((weight, flat[at : at + fan_out]))
            at += fan_out
        return layers

    def forward(self, flat: Array, inputs: Array) -> list[Array]:
        """The input and every layer's activation; the last is the output."""
        activations = [inputs]
        layers = self.layers(flat)
        for index, (weight, bias) in enumerate(layers):
            z = activations[-1] @ weight + bias
            activations.append(z if index == len(layers) - 1 else np.tanh(z))
        return activations

    def output(self, flat: Array, inputs: Array) -> Array:
        return self.forward(flat, inputs)[-1]

    def backward(self, flat: Array, activations: list[Array], grad: Array) -> Array:
        """d loss / d flat from d loss / d output."""
        parts: list[Array] = []
        layers = self.layers(flat)
        for index in reversed(range(len(layers))):
            parts = [(activations[index].T @ grad).ravel(), grad.sum(axis=0), *parts]
            if index:
                grad = (grad @ layers[index][0].T) * (1 - activations[index] ** 2)
        return np.concatenate(parts)


def softplus(z: Array) -> Array:
    return np.logaddexp(0, z)


def sigmoid(z: Array) -> Array:
    return 1 / (1 + np.exp(-z))


# ---------------------------------------------------------------------- distributions


@dataclass(frozen=True)
class Policy:
    """Diagonal Gaussian (box) or one categorical per action component (discrete)."""

    net: Mlp
    choices: tuple[int, ...] = ()
    """Number of choices per component; empty: a Gaussian"""

    @property
    def size(self) -> int:
        return self.net.size + (0 if self.choices else self.net.sizes[-1])

    def log_probs(self, flat: Array, obs: Array, actions: Array) -> Array:
        output = self.net.output(flat[: self.net.size], obs)
        if not self.choices:
            log_std = flat[self.net.size :]
            z = (actions - output) / np.exp(log_std)
            return _row_sums(-0.5 * z**2 - log_std - 0.5 * np.log(2 * np.pi))
        chosen = [
            log_softmax(part)[np.arange(len(obs)), actions[:, c].astype(int)]
            for c, part in enumerate(self.parts(output))
        ]
        return _row_sums(np.stack(chosen, axis=1))

    def kl(self, old: Array, new: Array, obs: Array) -> Array:
        """KL[pi_old | pi] per sample."""
        before = self.net.output(old[: self.net.size], obs)
        after = self.net.output(new[: self.net.size], obs)
        if not self.choices:
            log_old, log_new = old[self.net.size :], new[self.net.size :]
            var_old, var_new = np.exp(2 * log_old), np.exp(2 * log_new)
            square = (before - after) ** 2
            per_dimension = log_new - log_old + (var_old + square) / (2 * var_new) - 0.5
            return _row_sums(per_dimension)
        total = np.zeros(len(obs))
        for p, q in zip(self.parts(before), self.parts(after), strict=True):
            log_p, log_q = log_softmax(p), log_softmax(q)
            total += (np.exp(log_p) * (log_p - log_q)).sum(axis=1)
        return total

    def parts(self, logits: Array) -> list[Array]:
        """The logits of each action component."""
        return np.split(logits, np.cumsum(self.choices)[:-1], axis=1)


def _row_sums(terms: Array) -> Array:
    sums: Array = terms.sum(axis=1)
    return sums


def log_softmax(logits: Array) -> Array:
    return logits - np.logaddexp.reduce(logits, axis=1, keepdims=True)


# -------------------------------------------------------------------------- the chief


def average(gradients: list[Array], counts: list[int]) -> Array:
    """The mean over samples: each slot's own mean gradient, weighted by its samples."""
    weighted = np.stack([g * c for g, c in zip(gradients, counts, strict=True)], axis=1)
    return _row_sums(weighted) / sum(counts)


def clipped(gradient: Array, max_norm: float) -> Array:
    norm = np.linalg.norm(gradient)
    return gradient * (max_norm / norm) if norm > max_norm else gradient


class Adam:
    """Kingma & Ba 2015, Algorithm 1."""

    def __init__(self, size: int, eps: float, beta1: float = 0.9, beta2: float = 0.999) -> None:
        self.m, self.v, self.t = np.zeros(size), np.zeros(size), 0
        self.eps, self.beta1, self.beta2 = eps, beta1, beta2

    def step(self, flat: Array, gradient: Array, rate: float | Array) -> Array:
        self.t += 1
        self.m = self.beta1 * self.m + (1 - self.beta1) * gradient
        self.v = self.beta2 * self.v + (1 - self.beta2) * gradient**2
        m_hat = self.m / (1 - self.beta1**self.t)
        v_hat = self.v / (1 - self.beta2**self.t)
        return flat - rate * m_hat / (np.sqrt(v_hat) + self.eps)
