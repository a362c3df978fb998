"""Environments that something is wrong with; registered on import (`tests.odd_envs:Raises-v0`)."""

import os
import re
import signal
import time
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

SECONDS_PER_STEP = float(os.environ.get("ODD_SECONDS_PER_STEP", "0"))
"""Of this process: workers with different ones are differently fast."""


class Walk(gymnasium.Env[Any, Any]):
    """Two numbers to see, two actions, episodes of 16 steps; goes wrong in the 11th, if at all.

    Pictures are brighter with each step.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}  # noqa: RUF012  Gymnasium's

    def __init__(
        self,
        trouble: str = "",
        actions: Any = None,
        observations: Any = None,
        once: str = "",
        after: int = 0,
        while_there: str = "",
        endless: bool = False,
        render_mode: str | None = None,
    ) -> None:
        """With `once`, a file, trouble comes a single time, and not before `after` steps.

        It raises in every step while there is a file `while_there`. Endless: no episode ends.
        """
        self.action_space = actions or spaces.Discrete(2)
        self.observation_space = observations or spaces.Box(-1, 1, (2,))
        self.render_mode = render_mode
        self._trouble, self._steps = trouble, 0
        self._once, self._left = once, after
        self._last = 0 if endless else 16
        self._while_there = Path(while_there) if while_there else None

    def reset(self, *, seed: int | None = None, **_: Any) -> Any:
        super().reset(seed=seed)
        self._steps = 0
        return np.zeros(2, np.float32), {}

    def step(self, action: Any) -> Any:
        time.sleep(SECONDS_PER_STEP)
        if self._while_there is not None and self._while_there.exists():
            _strike("raise")
        self._steps += 1
        obs = np.array([self._steps / 16, float(np.sum(action))], np.float32)
        self._left -= 1
        if self._once and self._left < 0 and self._is_first():
            _strike(self._trouble)
        if self._steps == 11 and not self._once:
            if self._trouble == "raise":
                raise RuntimeError("the arm fell off")
            if self._trouble == "nan":
                obs = np.array([np.nan, 0], np.float32)
            if self._trouble == "dice":
                obs[1] = np.random.default_rng().random()
        return obs, 1.0, self._steps == self._last, False, {}

    def render(self) -> Any:
        return np.full((32, 32, 3), min(255, 15 * self._steps), np.uint8)

    def _is_first(self) -> bool:
        """Of all environments of all processes, exactly one goes wrong."""
        try:
            os.close(os.open(self._once, os.O_CREAT | os.O_EXCL))
        except FileExistsError:
            return False
        return True


def _strike(trouble: str) -> None:
    """Things that go wrong once."""
    match trouble:
        case "hang":
            while True:
                time.sleep(1)
        case "hold":  # the interpreter's lock, in C, practically for ever
            re.match(r"(a+)+$", "a" * 60 + "b")
        case "segfault":
            os.kill(os.getpid(), signal.SIGSEGV)
        case "memory":  # what the kernel does to a process that takes too much
            os.kill(os.getpid(), signal.SIGKILL)
        case "exit":
            os._exit(3)
        case "raise":
            raise RuntimeError("the arm fell off")


TROUBLES: dict[str, dict[str, Any]] = {
    "Raises-v0": {"trouble": "raise"},
    "NotANumber-v0": {"trouble": "nan"},
    "Dice-v0": {"trouble": "dice"},
    "Walk-v0": {},
    "Endless-v0": {"endless": True},
    "Choices-v0": {"actions": spaces.MultiDiscrete([3, 2], start=[1, -1])},
    "OddActions-v0": {"actions": spaces.MultiBinary(3)},
    "OddObservations-v0": {"observations": spaces.Text(3)},
}
for name, kwargs in TROUBLES.items():
    gymnasium.register(name, entry_point="tests.odd_envs:Walk", kwargs=kwargs)
