"""Workers without environments: they answer at once, with numbers made beforehand.

The learner cannot tell them from real ones: every message has the sizes of Ant-v4 and the default
networks. So what is left to measure is the learner and the wire.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from safetensors.numpy import save

from dppo.config import Config, RolloutConfig, SafetyConfig
from dppo.gradients import Sums
from dppo.moments import Moments
from dppo.networks import Networks
from dppo.spaces import Spaces
from dppo.sums import aligned_blocks
from dppo.wire.messages import (
    Collect,
    Collected,
    Gradient,
    Hello,
    Measure,
    Measured,
    Ready,
    ToLearner,
    ToWorker,
    Update,
    Welcome,
)

SPACES = Spaces(obs_size=27, action_kind="box", action_sizes=(8,))
_SAMPLES = RolloutConfig().samples_per_slot
_SNAPSHOT = save({"state": np.zeros(50_000, np.uint8)})
"""As long as a slot's environments, about."""


def config_of(slots: int) -> Config:
    """The default settings with ψ = 0.1 and so many slots."""
    return Config(rollout=RolloutConfig(slots=slots), safety=SafetyConfig(psi=0.1))


def networks_of(config: Config) -> Networks:
    """Policy, value and variance of Ant-v4."""
    return Networks.build(SPACES, config)


def _moments(size: int) -> NDArray[np.float64]:
    rows = np.random.default_rng(size).standard_normal((_SAMPLES, size))
    return Moments.of(rows).to_vector()


@dataclass
class Puppet:
    """One worker."""

    name: str
    size: int
    """P: parameters of the networks."""
    vector: NDArray[np.float32] = field(init=False)

    def __post_init__(self) -> None:
        """The gradient it will always send."""
        rng = np.random.default_rng(0)
        self.vector = rng.standard_normal(self.size).astype(np.float32)

    def hello(self) -> Hello:
        """Ask to join."""
        return Hello(worker=self.name, host="puppet", pid=0, numerics="same", versions="same")

    def answers(self, message: ToWorker) -> list[ToLearner]:
        """What a real worker would send, one message or several."""
        match message:
            case Welcome():
                return [
                    Ready(
                        worker=self.name,
                        generation=message.generation,
                        obs_size=SPACES.obs_size,
                        action_kind=SPACES.action_kind,
                        action_sizes=SPACES.action_sizes,
                        env_hash="",
                        exact="captured",
                    )
                ]
            case Collect():
                return [self._collected(message, slot) for slot in message.slots]
            case Update():
                return [self._gradient(message, *block) for block in aligned_blocks(message.slots)]
            case Measure():
                return [self._measured(message, *block) for block in aligned_blocks(message.slots)]
        return []

    def _collected(self, task: Collect, slot: int) -> Collected:
        return Collected(
            worker=self.name,
            generation=task.generation,
            iteration=task.iteration,
            round=task.round,
            slot=slot,
            obs=_moments(SPACES.obs_size),
            returns=_moments(1),
            advantages=_moments(3),
            fit=_moments(3),
            sigma_target=_moments(1),
            reward=_moments(1),
            start_sigma=_moments(1),
            episodes=np.array([100.0, 200.0]),
            exact=True,
            snapshot=_SNAPSHOT,
        )

    def _gradient(self, task: Update, first: int, size: int) -> Gradient:
        sums = Sums(policy_weight=64.0 * size, critic_weight=64.0 * size, kl_weight=64.0 * size)
        return Gradient(
            worker=self.name,
            generation=task.generation,
            iteration=task.iteration,
            round=task.round,
            first=first,
            size=size,
            stopped=(),
            vector=self.vector,
            sums=np.array([getattr(sums, name) for name in Sums.__slots__]),
        )

    def _measured(self, task: Measure, first: int, size: int) -> Measured:
        return Measured(
            worker=self.name,
            generation=task.generation,
            iteration=task.iteration,
            round=task.round,
            first=first,
            size=size,
            kls=np.full(size, 0.01 * _SAMPLES),
            weights=np.full(size, float(_SAMPLES)),
        )
