"""A trained policy as a torch module, for other people's programs.

The trainer itself computes in NumPy (docs/decisions/0002). This module takes a checkpoint's
policy, normaliser and action space together, so that raw observations go in and actions that the
environment takes come out.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from torch import Tensor, nn

from dppo.action_spaces import kind_and_sizes
from dppo.networks import Networks
from dppo.normalizer import CLOCK_UNIT
from dppo.store.checkpoint import Checkpoint
from dppo.store.contents import config_in, spaces_in, statistics_in

Layers = Sequence[tuple[NDArray[np.float32], NDArray[np.float32]]]
Normal = tuple[NDArray[np.float64], NDArray[np.float64], float]


class PolicyModule(nn.Module):
    """Normaliser, policy network and what an environment takes, as one module.

    Example:
        checkpoint = load_checkpoint(Path("runs/x/checkpoints/iteration-00000245"))
        policy = PolicyModule.load(checkpoint, env.action_space)
        action = policy(torch.as_tensor(obs)[None])[0].numpy()
    """

    mean: Tensor
    scale: Tensor

    def __init__(self, layers: Layers, normalizer: Normal, has_clock: bool) -> None:
        """Build from (W [I, O], b [O]) layers and (mean, scale, clip) of observations.

        With `has_clock` the network also sees how far the episode is.
        """
        super().__init__()
        modules: list[nn.Module] = []
        for weight, bias in layers:
            linear = nn.Linear(*weight.shape)
            linear.weight.data = torch.from_numpy(weight.T.copy())
            linear.bias.data = torch.from_numpy(bias.copy())
            modules += [linear, nn.Tanh()]
        self.network = nn.Sequential(*modules[:-1])
        mean, scale, self.clip = normalizer
        self.obs_size = len(mean)
        self.has_clock, self.clock_unit = has_clock, CLOCK_UNIT
        self.register_buffer("mean", torch.from_numpy(mean.copy()))
        self.register_buffer("scale", torch.from_numpy(scale.copy()))

    @classmethod
    def load(cls, checkpoint: Checkpoint, action_space: spaces.Space[Any]) -> "PolicyModule":
        """The policy of a checkpoint, to act with: without gradients.

        Args:
            checkpoint: from `dppo.store.checkpoint.load_checkpoint`.
            action_space: of the environment that is to take the actions. Checkpoints hold sizes
                alone; bounds, and numbers of first choices, are the space's.

        Raises:
            ValueError: the policy was trained for actions of another kind or size.
        """
        config = config_in(checkpoint)
        trained = spaces_in(checkpoint)
        if kind_and_sizes(action_space) != (trained.action_kind, trained.action_sizes):
            raise ValueError(
                f"action_space is {action_space}, expected one of the kind {trained.action_kind} "
                f"with sizes {trained.action_sizes}, as the policy was trained for"
            )
        networks = Networks.build(trained, config)
        vector, log_std = networks.split_policy(checkpoint.arrays["parameters"])
        normalizer = statistics_in(checkpoint).obs_normalizer(config.rollout)
        common = (
            networks.policy.layers(vector),
            (normalizer.mean, normalizer.scale, normalizer.clip),
            config.rollout.time_limit == "time-feature",
        )
        module: PolicyModule
        if isinstance(action_space, spaces.Box):
            low, high = (np.ravel(end) for end in (action_space.low, action_space.high))
            bounds = low.astype(np.float32), high.astype(np.float32)
            module = GaussianPolicy(*common, np.exp(log_std), bounds)
        else:
            first = np.ravel(getattr(action_space, "start", 0)).astype(np.int64)
            module = CategoricalPolicy(*common, trained.action_sizes, first)
        return module.requires_grad_(False).eval()

    def forward(self, obs: Tensor, steps: Tensor | None = None) -> Tensor:
        """Most likely actions [N, A], as the environment takes them, of raw observations [N, O].

        Of a Discrete space [N, 1]: its environment takes `[i, 0]`. A discrete action is a whole
        number per component. `steps` [N] since the reset are for
        policies with a time feature.

        Raises:
            ValueError: observations of another shape, or no steps for a time feature.
        """
        return self._mode(self._output(obs, steps))

    def sample(
        self,
        obs: Tensor,
        generator: torch.Generator | None = None,
        steps: Tensor | None = None,
    ) -> Tensor:
        """Sampled actions [N, A]; continuous ones are clipped after sampling as in training.

        Raises:
            ValueError: as `forward`.
        """
        return self._mode(self._noisy(self._output(obs, steps), generator))

    def _mode(self, output: Tensor) -> Tensor:
        """The most likely actions [N, A] of what the network puts out."""
        raise NotImplementedError

    def _noisy(self, output: Tensor, generator: torch.Generator | None) -> Tensor:
        """What the network puts out with noise, so that its mode is a sample."""
        raise NotImplementedError

    def _output(self, obs: Tensor, steps: Tensor | None) -> Tensor:
        """What the network makes of raw observations [N, O] after so many steps [N]."""
        if obs.dim() != 2 or obs.shape[1] != self.obs_size:
            raise ValueError(
                f"observations have shape {list(obs.shape)}, expected [N, {self.obs_size}]"
            )
        seen = ((obs.double() - self.mean) / self.scale).clamp(-self.clip, self.clip).float()
        if self.has_clock:
            if steps is None:
                raise ValueError(
                    "steps is missing, expected the steps since the reset, [N]: this policy has a "
                    "time feature"
                )
            seen = torch.cat([seen, (self.clock_unit * steps.double()).float()[:, None]], dim=1)
        output: Tensor = self.network(seen)
        return output


class GaussianPolicy(PolicyModule):
    """Of a continuous action space."""

    low: Tensor
    high: Tensor
    std: Tensor

    def __init__(
        self,
        layers: Layers,
        normalizer: Normal,
        has_clock: bool,
        std: NDArray[np.float32],
        bounds: tuple[NDArray[np.float32], NDArray[np.float32]],
    ) -> None:
        """Also from std [A] and bounds of actions [A]."""
        super().__init__(layers, normalizer, has_clock)
        self.register_buffer("std", torch.from_numpy(std.copy()))
        self.register_buffer("low", torch.from_numpy(bounds[0].copy()))
        self.register_buffer("high", torch.from_numpy(bounds[1].copy()))

    def _noisy(self, output: Tensor, generator: torch.Generator | None) -> Tensor:
        noise = torch.randn(output.shape, generator=generator, device=output.device)
        return output + self.std * noise

    def _mode(self, output: Tensor) -> Tensor:
        return torch.minimum(torch.maximum(output, self.low), self.high)


class CategoricalPolicy(PolicyModule):
    """Of a discrete action space, with one choice or several."""

    first: Tensor

    def __init__(
        self,
        layers: Layers,
        normalizer: Normal,
        has_clock: bool,
        sizes: Sequence[int],
        first: NDArray[np.int64],
    ) -> None:
        """Also from the number of choices of each component, and their first numbers."""
        super().__init__(layers, normalizer, has_clock)
        self.sizes = list(sizes)
        self.register_buffer("first", torch.from_numpy(first.copy()))

    def _noisy(self, output: Tensor, generator: torch.Generator | None) -> Tensor:
        uniform = torch.rand(
            output.shape, generator=generator, dtype=torch.float64, device=output.device
        )
        gumbel = -torch.log(-torch.log(uniform.clamp_min(1e-300)))
        return output + gumbel.float()

    def _mode(self, output: Tensor) -> Tensor:
        parts = [part.argmax(dim=1) for part in torch.split(output, self.sizes, dim=1)]
        return torch.stack(parts, dim=1) + self.first
