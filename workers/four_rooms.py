"""`FourRooms-v0`: the world of Safe Actor-Critic as a Gymnasium environment.

    gymnasium.make("workers.four_rooms:FourRooms-v0", slip_to="actions")

The name before the colon imports this module, which registers the environment. `dppo-learner --env
FourRooms-v0` needs no such name.
"""

from typing import Any, Literal, SupportsInt

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from dppo.four_rooms.world import ACTIONS, GOAL_REWARD, LAYOUT, MAX_STEPS, World, WorldConfig

_ID = "FourRooms-v0"
_PIXELS = 16
_COLOURS = {"w": (70, 70, 70), " ": (245, 245, 245), "f": (158, 202, 225), "G": (0, 158, 115)}
_AGENT = (213, 94, 0)


class FourRooms(gymnasium.Env[np.int64, np.int64]):
    """One agent in Four Rooms. It sees the number of its cell, which trainers flatten to one-hot.

    Keyword arguments are the fields of `WorldConfig`.
    """

    metadata = {"render_modes": ["rgb_array", "ansi"], "render_fps": 8}  # noqa: RUF012  Gymnasium's

    def __init__(
        self,
        render_mode: Literal["rgb_array", "ansi"] | None = None,
        **variant: Any,  # noqa: ANN401  fields
    ) -> None:
        self.world = World(WorldConfig(**variant))
        self.observation_space = spaces.Discrete(self.world.states)
        self.action_space = spaces.Discrete(len(ACTIONS))
        self.render_mode = render_mode
        self._cell = int(self.world.starts[0])

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.int64, dict[str, Any]]:
        """Begin anywhere but in the goal, or in the cell `options["cell"]`."""
        super().reset(seed=seed)
        start = self.np_random.choice(self.world.starts)
        if options and "cell" in options:
            start = options["cell"]
            if start not in self.world.starts:
                raise ValueError(
                    f"options['cell'] is {start}, expected a cell from 0 to "
                    f"{self.world.states - 1} other than the goal, {self.world.goal}"
                )
        self._cell = int(start)
        return np.int64(self._cell), {"frozen": bool(self.world.frozen[self._cell])}

    def step(self, action: SupportsInt) -> tuple[np.int64, float, bool, bool, dict[str, Any]]:
        """Move; the time limit is a wrapper's."""
        slip, pay = self.np_random.random(2)
        slot = int(self.world.slot(np.array(slip)))
        move = (self._cell, int(action), slot)
        reward = 0.0
        if self.world.noisy[move]:
            unit = 2 * pay - 1
            if self.world.config.noise == "normal":
                unit = self.np_random.standard_normal()
            reward = float(unit * self.world.config.noise_scale)
        self._cell = int(self.world.successor[move])
        terminated = self._cell == self.world.goal
        if terminated:
            reward += GOAL_REWARD
        frozen = bool(self.world.frozen[self._cell])
        return np.int64(self._cell), reward, terminated, False, {"frozen": frozen}

    def render(self) -> NDArray[np.uint8] | str | None:
        """A picture, or the map as text with the agent as A."""
        row, column = self.world.cells[self._cell]
        match self.render_mode:
            case "rgb_array":
                colours = [[_COLOURS[kind] for kind in line] for line in LAYOUT.splitlines()]
                colours[row][column] = _AGENT
                picture = np.array(colours, np.uint8)
                return picture.repeat(_PIXELS, axis=0).repeat(_PIXELS, axis=1)
            case "ansi":
                lines = [list(line) for line in LAYOUT.splitlines()]
                lines[row][column] = "A"
                return "\n".join("".join(line) for line in lines) + "\n"
        return None


def register() -> None:
    """Make the environment known to Gymnasium; a second time changes nothing."""
    if _ID not in gymnasium.registry:
        gymnasium.register(_ID, entry_point=FourRooms, max_episode_steps=MAX_STEPS)


register()
