"""Environments that something is wrong with; registered on import (`tests.odd_envs:Raises-v0`)."""

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces


class Walk(gymnasium.Env[Any, Any]):
    """Two numbers to see, two actions, episodes of 16 steps; goes wrong in the 11th, if at all."""

    def __init__(self, trouble: str = "", actions: Any = None, observations: Any = None) -> None:
        self.action_space = actions or spaces.Discrete(2)
        self.observation_space = observations or spaces.Box(-1, 1, (2,))
        self._trouble, self._steps = trouble, 0

    def reset(self, *, seed: int | None = None, **_: Any) -> Any:
        super().reset(seed=seed)
        self._steps = 0
        return np.zeros(2, np.float32), {}

    def step(self, action: Any) -> Any:
        self._steps += 1
        obs = np.array([self._steps / 16, float(np.sum(action))], np.float32)
        if self._steps == 11:
            if self._trouble == "raise":
                raise RuntimeError("the arm fell off")
            if self._trouble == "nan":
                obs = np.array([np.nan, 0], np.float32)
            if self._trouble == "dice":
                obs[1] = np.random.default_rng().random()
        return obs, 1.0, self._steps == 16, False, {}


TROUBLES: dict[str, dict[str, Any]] = {
    "Raises-v0": {"trouble": "raise"},
    "NotANumber-v0": {"trouble": "nan"},
    "Dice-v0": {"trouble": "dice"},
    "OddActions-v0": {"actions": spaces.MultiBinary(3)},
    "OddObservations-v0": {"observations": spaces.Text(3)},
}
for name, kwargs in TROUBLES.items():
    gymnasium.register(name, entry_point="tests.odd_envs:Walk", kwargs=kwargs)
