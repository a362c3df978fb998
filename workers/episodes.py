"""One environment of a slot: its episodes one after the other, and how to move it elsewhere."""

import logging
import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dppo.streams import reset_seed
from workers.envs import Adapter, Env, Exactness
from workers.snapshots import Arrays, capture, restore

log = logging.getLogger("worker")


class EnvironmentFailedError(Exception):
    """An environment raised, or returned what is not a number; slot, environment, step named."""


@dataclass(frozen=True, slots=True)
class Step:
    """What one step gave."""

    next_obs: NDArray[np.float64]  # [O]  the final observation if the episode ended
    reward: float
    terminated: bool
    truncated: bool


@dataclass(slots=True)
class Episodes:
    """One environment, reset with its own seed for every episode."""

    env: Env
    adapter: Adapter
    exact: Exactness
    seed: int
    slot: int
    index: int
    """Which of the slot's environments this is."""
    gamma: float
    episode: int = -1
    obs: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))
    """[O] s_t, raw."""
    steps: int = 0
    """Steps of the present episode so far."""
    score: float = 0.0
    """Undiscounted return of the present episode so far."""
    discounted: float = 0.0
    """Discounted sum of past rewards of this episode: what rewards are scaled by."""
    is_exact: bool = True
    """No move has changed what comes next."""
    _actions: list[NDArray[np.float32]] = field(default_factory=list)

    def begin(self) -> None:
        """Start the next episode."""
        self.episode += 1
        self.steps, self.score, self.discounted = 0, 0.0, 0.0
        self._actions.clear()
        self._reset()

    def step(self, action: NDArray[np.float32]) -> Step:
        """One step with [A]; the caller begins the next episode after an end."""
        if self.exact == "replayed":
            self._actions.append(action.copy())
        try:
            observation, reward, terminated, truncated, _ = self.env.step(
                self.adapter.to_env(action)
            )
            next_obs, reward = self.adapter.obs(observation), float(reward)
        except Exception as error:  # an environment may raise anything
            raise self._failed(f"raised {type(error).__name__}: {error}") from error
        self._check(next_obs, reward)
        self.obs = next_obs
        self.steps += 1
        self.score += reward
        self.discounted = self.gamma * self.discounted + reward
        return Step(next_obs, reward, bool(terminated), bool(truncated))

    def capture(self) -> Arrays:
        """Where this environment is, as arrays."""
        arrays: Arrays = {
            "obs": self.obs,
            "counts": np.array([self.episode, self.steps], np.int64),
            "sums": np.array([self.score, self.discounted]),
        }
        if self.exact == "captured":
            arrays |= capture(self.env)
        elif self.exact == "replayed":
            arrays["actions"] = np.array(self._actions, np.float32)
        return arrays

    def restore(self, arrays: Arrays) -> None:
        """Go to where `capture` was called; without exact environments, to a new episode."""
        self.episode, self.steps = (int(count) for count in arrays["counts"])
        if self.exact == "off":
            self.is_exact = False
            self.begin()
            return
        self.score, self.discounted = (float(value) for value in arrays["sums"])
        self._reset()
        if self.exact == "captured":
            restore(self.env, arrays)
        else:
            self._replay(arrays["actions"], arrays["obs"])
        self.obs = np.asarray(arrays["obs"], np.float64)

    def _replay(self, actions: NDArray[Any], obs: NDArray[Any]) -> None:
        self._actions = list(actions)
        reached = self.obs
        for action in actions:
            try:
                reached = self.adapter.obs(self.env.step(self.adapter.to_env(action))[0])
            except Exception as error:  # an environment may raise anything
                raise self._failed(f"raised {type(error).__name__}: {error}") from error
        if not np.array_equal(reached, obs):
            self.is_exact = False
            log.warning(
                "slot %d, environment %d: replaying %d actions ended in another observation; the "
                "environment is not deterministic, so this run is no longer exact",
                self.slot,
                self.index,
                len(actions),
            )

    def _reset(self) -> None:
        seed = reset_seed(self.seed, self.slot, self.index, self.episode)
        try:
            observation, _ = self.env.reset(seed=seed)
            self.obs = self.adapter.obs(observation)
        except Exception as error:  # an environment may raise anything
            raise self._failed(f"raised {type(error).__name__} in reset: {error}") from error
        self._check(self.obs, 0.0)

    def _check(self, obs: NDArray[np.float64], reward: float) -> None:
        """Shape by the space; then one number decides: a sum is finite unless a part is not."""
        if len(obs) != self.adapter.obs_size:
            raise self._failed(
                f"returned {len(obs)} numbers as an observation, its space has "
                f"{self.adapter.obs_size}"
            )
        if not math.isfinite(np.add.reduce(obs) + reward):
            what = "reward" if not np.isfinite(reward) else f"observation {obs.tolist()}"
            raise self._failed(f"returned a {what} that is not finite (reward {reward})")

    def _failed(self, what: str) -> EnvironmentFailedError:
        name = self.env.spec.id if self.env.spec else type(self.env).__name__
        return EnvironmentFailedError(
            f"slot {self.slot}, environment {self.index} ({name}) {what} at step {self.steps} of "
            f"episode {self.episode} (reset seed "
            f"{reset_seed(self.seed, self.slot, self.index, self.episode)})"
        )
