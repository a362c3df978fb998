"""Four Rooms as arrays: where a move leads, what it pays, and the same as probabilities.

A slip takes one of at most four ways, equally likely. Twelve is divisible by 1, 2, 3 and 4, so
twelve equally likely slots hold every case, and a thirteenth holds the move that was meant. Moving
is then one look-up, for one agent as for hundreds.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from dppo.four_rooms.mdp import Floats, Mdp
from dppo.settings import require, require_finite

Ints = NDArray[np.intp]

LAYOUT = """\
wwwwwwwwwwwww
w     w     w
w   ffwff   w
w  fffffff  w
w   ffwff   w
w     w     w
ww wwww     w
w     wwwGwww
w     w     w
w     w     w
w           w
w     w     w
wwwwwwwwwwwww"""
"""w wall, f frozen, G goal."""
ACTIONS = ("up", "down", "left", "right")
_DELTAS = ((-1, 0), (1, 0), (0, -1), (0, 1))  # row, column
SLIP_SLOTS = 12
SLOTS = SLIP_SLOTS + 1
GOAL_REWARD = 50.0
MAX_STEPS = 500


@dataclass(frozen=True, slots=True, kw_only=True)
class WorldConfig:
    """The variants of Four Rooms that the paper's text and its authors' programs describe."""

    slip: float = 0.2
    """Probability that a move goes elsewhere than meant [0..1]."""
    slip_to: Literal["neighbours", "actions"] = "neighbours"
    """A slip goes to an open neighbour, or is one of the four actions and may bump into a wall."""
    noise: Literal["uniform", "normal"] = "uniform"
    """Rewards of frozen cells: uniform between -noise_scale and noise_scale, or normal."""
    noise_scale: float = 15.0
    """Half width of the uniform, standard deviation of the normal rewards [reward]."""
    paid: Literal["entering", "leaving"] = "entering"
    """When a frozen cell pays: when it is entered (paper), or when it is left."""

    def __post_init__(self) -> None:
        """Refuse what is no world."""
        require_finite(self, "slip", "noise_scale")
        require(0 <= self.slip <= 1, "slip", self.slip, "0 .. 1")
        require(self.noise_scale >= 0, "noise_scale", self.noise_scale, ">= 0")

    @property
    def noise_variance(self) -> float:
        """Variance of one frozen reward [reward²]."""
        return self.noise_scale**2 / (3 if self.noise == "uniform" else 1)


class World:
    """The map of one variant. S = 104 free cells, numbered row by row; A = 4 actions."""

    def __init__(self, config: WorldConfig | None = None) -> None:
        self.config = config or WorldConfig()
        grid = np.array([list(row) for row in LAYOUT.splitlines()])
        self.cells: Ints = np.argwhere(grid != "w").astype(np.intp)  # [S, 2]  row, column
        kinds = grid[tuple(self.cells.T)]
        self.frozen: NDArray[np.bool_] = kinds == "f"  # [S]
        self.goal = int(np.flatnonzero(kinds == "G")[0])
        self.shape = grid.shape
        number = np.full(grid.shape, -1)
        number[tuple(self.cells.T)] = np.arange(len(self.cells))
        self.ways: Ints = np.array(  # [S, A]  the cell an action means; itself at a wall
            [
                [self._beside(number, cell, delta) for delta in _DELTAS]
                for cell in range(len(self.cells))
            ],
            np.intp,
        )

    def _beside(self, number: NDArray[np.int_], cell: int, delta: tuple[int, int]) -> int:
        there = int(number[tuple(self.cells[cell] + delta)])
        return cell if there < 0 else there

    def number_of(self, place: tuple[int, int]) -> int:
        """The number of the cell at (row, column)."""
        return int(np.flatnonzero((self.cells == place).all(axis=1))[0])

    @property
    def states(self) -> int:
        """S: free cells, with the goal."""
        return len(self.cells)

    @cached_property
    def starts(self) -> Ints:
        """[S - 1] the cells an episode may begin in: all but the goal."""
        return np.delete(np.arange(self.states), self.goal)

    @cached_property
    def successor(self) -> Ints:
        """[S, A, 13] next cells: twelve equally likely slips, then the cell that is meant."""
        table = np.empty((self.states, len(ACTIONS), SLOTS), np.intp)
        for cell, ways in enumerate(self.ways):
            open_ways = ways[ways != cell] if self.config.slip_to == "neighbours" else ways
            table[cell, :, :SLIP_SLOTS] = np.repeat(open_ways, SLIP_SLOTS // len(open_ways))
            table[cell, :, SLIP_SLOTS] = ways
        return table

    @cached_property
    def noisy(self) -> NDArray[np.bool_]:
        """[S, A, 13] does this move pay a frozen cell's reward? Bumping into a wall never does."""
        here = np.arange(self.states)[:, None, None]
        paying = self.successor if self.config.paid == "entering" else here
        pays: NDArray[np.bool_] = self.frozen[paying] & (self.successor != here)
        return pays

    def slot(self, uniform: Floats) -> Ints:
        """The slots of uniform random numbers: a slip with probability `slip`."""
        if self.config.slip == 0:
            return np.full(uniform.shape, SLIP_SLOTS, np.intp)
        scaled = uniform * (SLIP_SLOTS / self.config.slip)
        return np.minimum(scaled, SLIP_SLOTS).astype(np.intp)

    @cached_property
    def mdp(self) -> Mdp:
        """The same world as probabilities, for the oracle; without the limit of 500 steps."""
        slip = self.config.slip
        weight = np.array([slip / SLIP_SLOTS] * SLIP_SLOTS + [1 - slip])
        transition = np.zeros((self.states, len(ACTIONS), self.states))
        noise = np.zeros_like(transition)
        here, action = np.ogrid[: self.states, : len(ACTIONS)]
        for slot in range(SLOTS):
            there = self.successor[:, :, slot]
            transition[here, action, there] += weight[slot]
            noise[here, action, there] = self.config.noise_variance * self.noisy[:, :, slot]
        transition[self.goal] = 0
        reward = np.zeros_like(transition)
        reward[:, :, self.goal] = GOAL_REWARD
        start = np.zeros(self.states)
        start[self.starts] = 1 / len(self.starts)
        return Mdp(transition=transition, reward=reward, noise=noise, start=start)
