"""Tanh networks over one flat float32 vector, with their gradients written out.

Shape letters: N samples · O observation size (with the time feature) · P parameters of a run.

Why not a module tree: a gradient is computed for some dozen rows at a time, hundreds of times a
second, and the bits must not depend on what else the process does. Three matrix products per layer
in NumPy take a quarter of the time of an autograd graph (docs/decisions/0002); a test holds every
gradient against torch's.
"""

import math
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from dppo.config import Config, NetworkConfig
from dppo.spaces import Spaces
from dppo.streams import stream

Float32 = NDArray[np.float32]
Network = Literal["policy", "value", "variance"]
Layers = list[tuple[Float32, Float32]]
"""W [..., I, O] and b [..., O] of each layer."""


@dataclass(frozen=True, slots=True)
class Mlp:
    """A multilayer perceptron: tanh between layers, linear at the end.

    Its parameters are a flat vector: W_1 row by row, b_1, W_2, ...; W is [inputs, outputs].
    """

    sizes: tuple[int, ...]
    """Units of each layer, input and output included."""

    @property
    def size(self) -> int:
        """Number of parameters."""
        return sum((a + 1) * b for a, b in pairwise(self.sizes))

    def layers(self, vector: Float32) -> Layers:
        """Views (W [..., I, O], b [..., O]) of each layer into vectors [..., `size`]."""
        lead = vector.shape[:-1]
        return [
            (
                vector[..., start:middle].reshape(*lead, inputs, outputs),
                vector[..., middle:stop],
            )
            for start, middle, stop, inputs, outputs in _layout(self.sizes)
        ]

    def forward(self, vector: Float32, x: Float32) -> tuple[Float32, list[Float32]]:
        """Output [..., N, K] of x [..., N, O]; each layer's input for `backward`.

        Axes before the last of `vector` are several networks of this shape, each applied to x.
        """
        inputs: list[Float32] = []
        return through(self.layers(vector), x, inputs), inputs

    def backward(
        self, vector: Float32, inputs: list[Float32], d_output: Float32, gradient: Float32
    ) -> None:
        """Write ∂L/∂parameters into `gradient` [..., `size`], given ∂L/∂output [..., N, K].

        Sums over N, not over the axes before it.
        """
        layers, gradients = self.layers(vector), self.layers(gradient)
        ones = row_of_ones(d_output.shape[-2])
        for index in range(len(layers) - 1, -1, -1):
            x, (d_weight, d_bias) = inputs[index], gradients[index]
            np.matmul(x.swapaxes(-1, -2), d_output, out=d_weight)
            np.matmul(ones, d_output, out=d_bias[..., None, :])
            if index > 0:
                back = np.ascontiguousarray(layers[index][0].swapaxes(-1, -2))
                d_output = d_output * back if d_output.shape[-1] == 1 else d_output @ back
                slope = x * x
                np.subtract(1, slope, out=slope)  # the derivative of tanh, from its value
                d_output *= slope

    def initial(
        self, rng: np.random.Generator, init: Literal["orthogonal", "fan-in"], last_gain: float
    ) -> Float32:
        """Initial parameters: biases 0, weights orthogonal (gain √2) or N(0, 1/fan_in)."""
        vector = np.zeros(self.size, np.float32)
        layers = self.layers(vector)
        for index, (weight, _) in enumerate(layers):
            if init == "fan-in":
                weight[:] = rng.standard_normal(weight.shape) / math.sqrt(len(weight))
            else:
                gain = last_gain if index == len(layers) - 1 else math.sqrt(2)
                weight[:] = gain * _orthogonal(rng, *weight.shape)
        return vector


def through(layers: Layers, x: Float32, inputs: list[Float32] | None = None) -> Float32:
    """Output [..., N, K] of x [..., N, O]; `inputs` collects each layer's input."""
    for index, (weight, bias) in enumerate(layers):
        if inputs is not None:
            inputs.append(x)
        x = x @ weight
        x += bias[..., None, :]
        if index < len(layers) - 1:
            np.tanh(x, out=x)
    return x


@cache
def _layout(sizes: tuple[int, ...]) -> tuple[tuple[int, int, int, int, int], ...]:
    """Where W and b of each layer begin and end, and the layer's inputs and outputs."""
    layout, start = [], 0
    for inputs, outputs in pairwise(sizes):
        middle = start + inputs * outputs
        layout.append((start, middle, middle + outputs, inputs, outputs))
        start = middle + outputs
    return tuple(layout)


@cache
def row_of_ones(count: int) -> Float32:
    """[1, count] to sum over samples by a matrix product: the fastest exact way."""
    return np.ones((1, count), np.float32)


def _orthogonal(rng: np.random.Generator, rows: int, columns: int) -> NDArray[np.float64]:
    tall = rng.standard_normal((max(rows, columns), min(rows, columns)))
    q, r = np.linalg.qr(tall)
    q *= np.sign(np.diag(r))
    return q if rows >= columns else q.T


@dataclass(frozen=True)
class Networks:
    """Policy, value and variance network of a run, and where each lies in the flat vector."""

    policy: Mlp
    value: Mlp
    has_variance: bool
    """A variance network, of the value network's shape; only psi 0 does without."""
    log_std_size: int
    """A for Gaussian policies, 0 for categorical ones; lies right behind the policy's layers."""

    @classmethod
    def build(cls, spaces: Spaces, config: Config) -> "Networks":
        """The networks that a config asks for, on an environment of these sizes."""
        obs = spaces.obs_size + (config.rollout.time_limit == "time-feature")
        policy = (obs, *_hidden(config.network, obs, 10 * spaces.action_size), spaces.output_size)
        critic = Mlp((obs, *_hidden(config.network, obs, 5), 1))
        return cls(
            policy=Mlp(policy),
            value=critic,
            has_variance=config.safety.variance_critic,
            log_std_size=spaces.action_size if spaces.action_kind == "box" else 0,
        )

    @cached_property
    def parts(self) -> dict[Network, slice]:
        """Where each network's parameters lie in the run's vector."""
        ends = [self.policy.size + self.log_std_size]
        ends.append(ends[-1] + self.value.size)
        slices: dict[Network, slice] = {
            "policy": slice(0, ends[0]),
            "value": slice(ends[0], ends[1]),
        }
        if self.has_variance:
            slices["variance"] = slice(ends[1], ends[1] + self.value.size)
        return slices

    @cached_property
    def critics(self) -> slice:
        """Where the critics' parameters lie: V's, then σ's if there is one."""
        return slice(self.parts["value"].start, self.size)

    @property
    def size(self) -> int:
        """P: parameters of all networks."""
        return max(int(part.stop) for part in self.parts.values())

    def split_policy(self, vector: Float32) -> tuple[Float32, Float32]:
        """The policy's part of the run's vector, as (layers, log std)."""
        return vector[: self.policy.size], vector[
            self.policy.size : self.policy.size + self.log_std_size
        ]

    def critic(self, name: Literal["value", "variance"], vector: Float32, obs: Float32) -> Float32:
        """[..., N] outputs of a critic for observations [..., N, O]; the run's vector [P]."""
        output, _ = self.value.forward(vector[self.parts[name]], obs)
        return output[..., 0]

    def initial(self, config: Config) -> Float32:
        """[P] initial parameters; each network has its own stream of the run's seed."""
        vector = np.zeros(self.size, np.float32)
        parts = self.parts
        networks: dict[Network, tuple[Mlp, float]] = {
            "policy": (self.policy, 0.01),
            "value": (self.value, 1.0),
        }
        if self.has_variance:
            networks["variance"] = (self.value, 1.0)
        for index, (name, (mlp, last_gain)) in enumerate(networks.items()):
            rng = stream(config.run.seed, "init", index)
            part = vector[parts[name]]
            part[: mlp.size] = mlp.initial(rng, config.network.init, last_gain)
        self.split_policy(vector)[1][:] = config.network.log_std_init
        return vector

    def log_std_rate(self, config: NetworkConfig) -> float:
        """Learning-rate factor of log std.

        The paper's baseline moves log *variance* (10 h3) // 48 times as fast as the rest; log std
        is half of that, and never nothing.
        """
        if config.log_std_rate > 0:
            return config.log_std_rate
        return max(1, (10 * self.policy.sizes[-2]) // 48) / 2


def _hidden(config: NetworkConfig, obs: int, last: int) -> tuple[int, ...]:
    """Hidden sizes; the paper's recipe: 10 O, the geometric mean, `last`."""
    if config.architecture == "mlp":
        return config.hidden_sizes
    first = 10 * obs
    return (first, int(math.sqrt(first * last)), last)
