"""What all workers share about the scale of things; frozen during an iteration.

Three sets of moments over the whole experiment (Heess et al. 2017: "sharing and synchronization
of various statistics"): observations, the running discounted return, and the targets of σ. The
last is kept in raw reward², so that it survives a change of the reward scale.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dppo.config import Config, RolloutConfig
from dppo.moments import FloatArray, Moments

Float32 = NDArray[np.float32]
CLOCK_UNIT = 0.001
"""Of the time feature: 0.001 t."""


def with_clock(seen: Float32, steps: NDArray[np.number]) -> Float32:
    """`seen` [..., O] with the time feature behind; `steps` [...] since the episode's start."""
    feature = (CLOCK_UNIT * steps[..., None]).astype(np.float32)
    return np.concatenate([seen, feature], axis=-1)


@dataclass(frozen=True, slots=True)
class ObsNormalizer:
    """(o − mean) / scale, clipped."""

    mean: FloatArray  # [O]
    scale: FloatArray  # [O]
    clip: float

    def __call__(self, obs: FloatArray) -> Float32:
        """Normalised observations [..., O] from raw ones."""
        scaled = (obs - self.mean) / self.scale
        np.minimum(np.maximum(scaled, -self.clip, out=scaled), self.clip, out=scaled)
        return scaled.astype(np.float32)


@dataclass(frozen=True, slots=True)
class Statistics:
    """Moments at the start of an iteration."""

    obs: Moments  # [O] raw observations
    returns: Moments  # [1] the discounted return so far, at every step; raw reward
    sigma_target: Moments  # [1] targets of σ; raw reward²

    @classmethod
    def empty(cls, obs_size: int) -> "Statistics":
        """Before the first iteration."""
        return cls(Moments.empty(obs_size), Moments.empty(1), Moments.empty(1))

    @classmethod
    def from_vectors(
        cls, obs: FloatArray, returns: FloatArray, sigma_target: FloatArray
    ) -> "Statistics":
        """From the form that travels."""
        return cls(*map(Moments.from_vector, (obs, returns, sigma_target)))

    def to_vectors(self) -> dict[str, FloatArray]:
        """The inverse of `from_vectors`, by name."""
        return {
            "obs": self.obs.to_vector(),
            "returns": self.returns.to_vector(),
            "sigma_target": self.sigma_target.to_vector(),
        }

    def merge(self, other: "Statistics") -> "Statistics":
        """With one slot's iteration added."""
        return Statistics(
            self.obs.merge(other.obs),
            self.returns.merge(other.returns),
            self.sigma_target.merge(other.sigma_target),
        )

    def obs_normalizer(self, config: RolloutConfig) -> "ObsNormalizer":
        """How the networks see observations; as they are before any were seen."""
        size = len(self.obs.mean)
        if config.normalize_obs == "off":
            return ObsNormalizer(np.zeros(size), np.ones(size), np.inf)
        if self.obs.count == 0:
            return ObsNormalizer(np.zeros(size), np.ones(size), config.clip_obs)
        std = self.obs.std(floor=0)
        paper = config.normalize_obs == "paper"
        scale = 3 * (std + 0.1) if paper else np.sqrt(np.square(std) + 1e-8)
        return ObsNormalizer(self.obs.mean, scale, config.clip_obs)

    def reward_scale(self, config: Config) -> float:
        """c: what rewards are multiplied by. One scale feeds V, δ and σ."""
        match config.rollout.reward_scale:
            case "off":
                return 1.0
            case "one-minus-gamma":
                gamma = config.returns.gamma
                return 1 - gamma if gamma < 0.999 else 1.0
            case "running-std":
                return 1 / self._returns_std()

    def _returns_std(self) -> float:
        return float(self.returns.std(floor=1e-4)[0])

    def sigma_scale(self, config: Config) -> float:
        """What the variance network's output is multiplied by, in (c · reward)².

        The standard deviation of σ's targets; before there are any, the variance of the returns.
        """
        if self.sigma_target.count == 0:
            return self._returns_std() ** 2 * self.sigma_unit(config)
        return float(self.sigma_target.std(floor=1e-12)[0]) * self.sigma_unit(config)

    def sigma_unit(self, config: Config) -> float:
        """σ in the trainer's units from σ in raw reward²: c², or 1 if raw rewards feed δ."""
        return 1.0 if config.returns.delta_reward == "raw" else self.reward_scale(config) ** 2
