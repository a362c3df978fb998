"""Episodes of policies that no longer learn: where they spend their time, and single walks."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dppo.four_rooms.draws import BLOCK, draw
from dppo.four_rooms.mdp import Floats
from dppo.four_rooms.world import MAX_STEPS, World

TEST_EPISODES = 80
"""The paper's number of testing trials (fig. 3)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Visits:
    """Test episodes of several policies."""

    share: Floats  # [S]  part of the time that is spent in each cell, all policies together
    touching: float
    """Part of the episodes begun off the ice that step on it."""


def visits(
    world: World, policies: Sequence[Floats], *, seed: int, episodes: int = TEST_EPISODES
) -> Visits:
    """Run `episodes` episodes of each policy, all policies side by side."""
    count = len(policies)
    limits = np.add.accumulate(np.array(policies), axis=2)[:, :, :-1]  # [B, S, A - 1]
    time = np.zeros((count, world.states), np.int64)
    everyone = np.arange(count)
    state, steps, episode = np.zeros((3, count), np.intp)
    dry, touched, begun_dry, wet = np.zeros((4, count), np.int64)
    block = 0
    while (episode < episodes).any():
        draws = draw(world, seed, "test", range(count), block)
        for step in range(BLOCK):
            fresh = steps == 0
            state = np.where(fresh, draws.start[step], state)
            going = episode < episodes
            dry = np.where(fresh, ~world.frozen[state], dry)
            wet = np.where(fresh, 0, wet)
            time[everyone, state] += going
            action = (draws.action[step][:, None] >= limits[everyone, state]).sum(axis=1)
            state = world.successor[state, action, draws.slot[step]]
            wet |= world.frozen[state]
            steps += 1
            ended = (state == world.goal) | (steps == MAX_STEPS)
            counted = ended & going
            begun_dry += counted & (dry == 1)
            touched += counted & (dry == 1) & (wet == 1)
            episode += ended
            steps[ended] = 0
        block += 1
    return Visits(
        share=time.sum(axis=0) / time.sum(), touching=float(touched.sum() / begun_dry.sum())
    )


def walk(world: World, policy: Floats, *, start: int, seed: int, number: int) -> NDArray[np.intp]:
    """[n] the cells of one episode, from `start` to the goal or the time limit."""
    draws = draw(world, seed, "walk", [number], 0)
    cells = [start]
    for step in range(MAX_STEPS):
        here = cells[-1]
        action = int((draws.action[step, 0] >= np.add.accumulate(policy[here])[:-1]).sum())
        cells.append(int(world.successor[here, action, draws.slot[step, 0]]))
        if cells[-1] == world.goal:
            break
    return np.array(cells, np.intp)
