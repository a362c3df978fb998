"""Random numbers of trials that advance together; each trial has a stream of its own.

A block holds the numbers of K steps. Which numbers a trial gets depends on the seed, the trial and
the step, and on nothing else: not on the trials beside it, nor on when one of them ends.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from dppo.four_rooms.mdp import Floats
from dppo.four_rooms.world import Ints, World
from dppo.streams import stream

BLOCK = 2048
"""K: steps that are drawn at once."""
Use = Literal["learn", "test", "walk", "bootstrap", "begin"]
_USES: tuple[Use, ...] = ("learn", "test", "walk", "bootstrap", "begin")
"""The place is the key: new ones at the end."""


@dataclass(frozen=True, slots=True)
class Draws:
    """The numbers of K steps of B trials, one row per step."""

    slot: Ints  # [K, B]  where the move goes
    noise: Floats  # [K, B]  what a frozen cell pays
    action: Floats  # [K, B]  uniform, for the next action
    start: Ints  # [K, B]  where the next episode begins, if one does
    first_action: Floats  # [K, B]  uniform, for its first action


def generator_of(seed: int, use: Use, trial: int, block: int) -> np.random.Generator:
    """The generator of one trial's block."""
    return stream(seed, "four-rooms", _USES.index(use), trial, block)


def draw(world: World, seed: int, use: Use, trials: Sequence[int], block: int) -> Draws:
    """Block number `block` of each of the trials."""
    uniform = np.empty((5, BLOCK, len(trials)))
    noise = np.empty((BLOCK, len(trials)))
    for place, trial in enumerate(trials):
        generator = generator_of(seed, use, trial, block)
        uniform[:, :, place] = generator.random((5, BLOCK))
        if world.config.noise == "normal":
            noise[:, place] = generator.standard_normal(BLOCK)
    if world.config.noise == "uniform":
        noise = 2 * uniform[4] - 1
    return Draws(
        slot=world.slot(uniform[0]),
        noise=noise * world.config.noise_scale,
        action=uniform[1],
        start=world.starts[(uniform[2] * len(world.starts)).astype(np.intp)],
        first_action=uniform[3],
    )
