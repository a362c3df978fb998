"""A trained policy as a torch module, for other people's programs.

The trainer itself computes in NumPy (docs/decisions/0002). This module takes a checkpoint's
policy, normaliser and action bounds together, so that raw observations go in and actions that the
environment takes come out.
"""

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from dppo.config import Config
from dppo.networks import Networks
from dppo.store.checkpoint import Checkpoint
from dppo.store.contents import spaces_in, statistics_in


class PolicyModule(nn.Module):
    """Normaliser, policy network and clipping as one module.

    Example:
        policy = PolicyModule.load(load_checkpoint(Path("runs/x/checkpoints/iteration-00000245")))
        action = policy(torch.as_tensor(obs)[None])[0]
    """

    mean: Tensor
    scale: Tensor
    low: Tensor
    high: Tensor
    std: Tensor

    def __init__(
        self,
        layers: Sequence[tuple[NDArray[np.float32], NDArray[np.float32]]],
        normalizer: tuple[NDArray[np.float64], NDArray[np.float64], float],
        std: NDArray[np.float32],
        bounds: tuple[NDArray[np.float32], NDArray[np.float32]],
    ) -> None:
        """Build from (W [I, O], b [O]) layers, (mean, scale, clip), std [A] and action bounds."""
        super().__init__()
        modules: list[nn.Module] = []
        for weight, bias in layers:
            linear = nn.Linear(*weight.shape)
            linear.weight.data = torch.from_numpy(weight.T.copy())
            linear.bias.data = torch.from_numpy(bias.copy())
            modules += [linear, nn.Tanh()]
        self.network = nn.Sequential(*modules[:-1])
        mean, scale, self.clip = normalizer
        self.register_buffer("mean", torch.from_numpy(mean.copy()))
        self.register_buffer("scale", torch.from_numpy(scale.copy()))
        self.register_buffer("std", torch.from_numpy(std.copy()))
        self.register_buffer("low", torch.from_numpy(bounds[0].copy()))
        self.register_buffer("high", torch.from_numpy(bounds[1].copy()))

    @classmethod
    def load(
        cls,
        checkpoint: Checkpoint,
        low: NDArray[np.float32] | float = -np.inf,
        high: NDArray[np.float32] | float = np.inf,
    ) -> "PolicyModule":
        """The policy of a checkpoint.

        Args:
            checkpoint: from `dppo.store.checkpoint.load_checkpoint`.
            low, high: bounds of the environment's action space, [A] or one number.

        Raises:
            ValueError: the policy is not a Gaussian one, or needs a time feature.
        """
        config = Config.from_dict(checkpoint.facts["config"])
        spaces = spaces_in(checkpoint)
        if spaces.action_kind != "box" or config.rollout.time_limit != "bootstrap":
            raise ValueError(
                f"this policy has {spaces.action_kind} actions and time limit "
                f"{config.rollout.time_limit}; PolicyModule takes box actions and bootstrap"
            )
        networks = Networks.build(spaces, config)
        vector, log_std = networks.split_policy(checkpoint.arrays["parameters"])
        normalizer = statistics_in(checkpoint).obs_normalizer(config.rollout)
        shape = (spaces.action_size,)
        bounds = (
            np.broadcast_to(np.float32(low), shape),
            np.broadcast_to(np.float32(high), shape),
        )
        normal = (normalizer.mean, normalizer.scale, normalizer.clip)
        return cls(networks.policy.layers(vector), normal, np.exp(log_std), bounds)

    def forward(self, obs: Tensor) -> Tensor:
        """Most likely actions [N, A], within bounds, of raw observations [N, O]."""
        return self._bounded(self._mean_action(obs))

    def sample(self, obs: Tensor, generator: torch.Generator | None = None) -> Tensor:
        """Sampled actions [N, A], clipped after sampling as in training."""
        mean = self._mean_action(obs)
        return self._bounded(mean + self.std * torch.randn(mean.shape, generator=generator))

    def _mean_action(self, obs: Tensor) -> Tensor:
        scaled = ((obs.double() - self.mean) / self.scale).clamp(-self.clip, self.clip)
        action: Tensor = self.network(scaled.float())
        return action

    def _bounded(self, action: Tensor) -> Tensor:
        return torch.minimum(torch.maximum(action, self.low), self.high)
