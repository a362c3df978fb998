"""Everything that a run is between two iterations; what a checkpoint holds."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dppo.adam import AdamState
from dppo.config import Config
from dppo.networks import Network, Networks
from dppo.normalizer import Statistics
from dppo.store.checkpoint import Checkpoint
from dppo.store.contents import mean_reward, statistics_in

Float32 = NDArray[np.float32]
RECENT_EPISODES = 100


@dataclass(frozen=True, slots=True, kw_only=True)
class State:
    """The run at the start of `iteration`. Arrays are replaced, never changed in place."""

    iteration: int
    parameters: Float32  # [P]
    optimizers: dict[Network, AdamState]
    statistics: Statistics
    beta: float
    """β."""
    psi: float
    """ψ before its schedule; moved by dual steps under a variance limit."""
    servo: float
    """Factor of the policy's step size (lr_schedule servo)."""
    episodes: NDArray[np.float64]  # [<= 100, 2] newest episodes: return, length
    finished_episodes: int
    dropped_gradients: int
    best_mean: float
    """Highest mean return of the newest episodes at a checkpoint; -inf before."""
    mean_reward: float
    """Of a step, over all of the iteration before; 0 before the first."""
    snapshots: dict[int, bytes]
    """Slot to its environments; empty before the first iteration."""

    @classmethod
    def initial(cls, networks: Networks, obs_size: int, config: Config) -> "State":
        """The run before its first iteration."""
        return cls(
            iteration=0,
            parameters=networks.initial(config),
            optimizers={
                name: AdamState.zero(part.stop - part.start)
                for name, part in networks.parts.items()
            },
            statistics=Statistics.empty(obs_size),
            beta=config.kl.kl_coef,
            psi=config.safety.psi,
            servo=1.0,
            episodes=np.empty((0, 2)),
            finished_episodes=0,
            dropped_gradients=0,
            best_mean=-np.inf,
            mean_reward=0.0,
            snapshots={},
        )

    @property
    def mean_return(self) -> float:
        """Mean return of the newest episodes; -inf before any has finished."""
        return float(self.episodes[:, 0].mean()) if len(self.episodes) else -np.inf

    def with_episodes(self, episodes: NDArray[np.float64]) -> "State":
        """With newly finished episodes, in slot order."""
        return replace(
            self,
            episodes=np.concatenate([self.episodes, episodes])[-RECENT_EPISODES:],
            finished_episodes=self.finished_episodes + len(episodes),
        )

    def to_checkpoint(self, facts: dict[str, Any]) -> Checkpoint:
        """As arrays and JSON; `facts` are kept beside the state's own."""
        arrays: dict[str, NDArray[Any]] = {
            "parameters": self.parameters,
            "episodes": self.episodes,
        }
        for name, vector in self.statistics.to_vectors().items():
            arrays[f"statistics/{name}"] = vector
        for network, adam in self.optimizers.items():
            arrays[f"adam/{network}/mean"] = adam.mean
            arrays[f"adam/{network}/square"] = adam.square
        for slot, snapshot in self.snapshots.items():
            arrays[f"slot/{slot}"] = np.frombuffer(snapshot, np.uint8)
        own = {
            "iteration": self.iteration,
            "beta": self.beta,
            "psi": self.psi,
            "servo": self.servo,
            "finished_episodes": self.finished_episodes,
            "dropped_gradients": self.dropped_gradients,
            "best_mean": self.best_mean if self.best_mean > -np.inf else None,
            "mean_reward": self.mean_reward,
            "adam_updates": {name: adam.updates for name, adam in self.optimizers.items()},
        }
        return Checkpoint(arrays, {"state": own, **facts})

    @classmethod
    def from_checkpoint(cls, checkpoint: Checkpoint) -> "State":
        """The inverse of `to_checkpoint`."""
        arrays, own = checkpoint.arrays, checkpoint.facts["state"]
        best = own["best_mean"]
        return cls(
            iteration=own["iteration"],
            parameters=arrays["parameters"],
            optimizers={
                name: AdamState(
                    arrays[f"adam/{name}/mean"], arrays[f"adam/{name}/square"], updates
                )
                for name, updates in own["adam_updates"].items()
            },
            statistics=statistics_in(checkpoint),
            beta=own["beta"],
            psi=own["psi"],
            servo=own["servo"],
            episodes=arrays["episodes"],
            finished_episodes=own["finished_episodes"],
            dropped_gradients=own["dropped_gradients"],
            best_mean=-np.inf if best is None else best,
            mean_reward=mean_reward(checkpoint),
            snapshots={
                int(name.split("/")[1]): array.tobytes()
                for name, array in arrays.items()
                if name.startswith("slot/")
            },
        )
