"""Four Rooms as arrays: the map, its slips, what its cells pay."""

import re

import numpy as np
import pytest

from dppo.four_rooms.mdp import Mdp
from dppo.four_rooms.world import ACTIONS, World, WorldConfig

UP, DOWN, LEFT, RIGHT = range(4)
WORLD = World()


def ways(world, place, action):
    """Where an action may lead: (row, column) -> probability."""
    row = world.mdp.transition[world.number_of(place), action]
    return {
        (int(r), int(c)): round(float(row[cell]), 12)
        for cell, (r, c) in enumerate(world.cells)
        if row[cell]
    }


def test_the_map_has_104_free_cells_15_of_them_frozen_and_the_goal_in_the_east_hallway():
    assert (WORLD.states, int(WORLD.frozen.sum()), WORLD.goal) == (104, 15, 62)
    assert WORLD.cells[WORLD.goal].tolist() == [7, 9]
    assert ACTIONS == ("up", "down", "left", "right")


def test_an_episode_begins_in_any_of_the_other_103_cells():
    assert len(WORLD.starts) == 103
    assert WORLD.mdp.start[WORLD.goal] == 0
    assert WORLD.mdp.start.sum() == pytest.approx(1)


def test_a_slip_goes_to_an_open_neighbour():
    # in the corner two neighbours are open: 0.2 / 2 each, and 0.8 for the wall that was meant
    assert ways(WORLD, (1, 1), UP) == {(1, 1): 0.8, (1, 2): 0.1, (2, 1): 0.1}
    # in the middle of a room all four are, the meant one among them
    assert ways(WORLD, (9, 3), LEFT) == {
        (9, 2): 0.85, (9, 4): 0.05, (8, 3): 0.05, (10, 3): 0.05,
    }  # fmt: skip


def test_a_slip_to_an_action_may_bump_into_a_wall():
    world = World(WorldConfig(slip_to="actions"))
    assert ways(world, (1, 1), UP) == {(1, 1): 0.9, (1, 2): 0.05, (2, 1): 0.05}


def test_without_slips_a_move_goes_where_it_is_meant():
    assert ways(World(WorldConfig(slip=0.0)), (1, 1), RIGHT) == {(1, 2): 1.0}


def test_the_goal_has_no_way_out():
    assert not WORLD.mdp.transition[WORLD.goal].any()


def test_entering_the_goal_pays_50_and_nothing_else_pays_on_average():
    above = WORLD.number_of((6, 9))
    assert WORLD.mdp.reward[above, DOWN, WORLD.goal] == 50
    assert WORLD.mdp.reward[:, :, WORLD.starts].tolist() == np.zeros((104, 4, 103)).tolist()


def test_entering_ice_pays_a_uniform_reward_of_variance_75():
    beside, ice = WORLD.number_of((3, 2)), WORLD.number_of((3, 3))
    assert WORLD.mdp.noise[beside, RIGHT, ice] == 15**2 / 3
    assert WORLD.mdp.noise[ice, LEFT, beside] == 0


def test_bumping_into_a_wall_on_the_ice_pays_nothing():
    ice = WORLD.number_of((2, 5))  # a wall to its right
    assert WORLD.mdp.noise[ice, RIGHT, ice] == 0


def test_leaving_ice_pays_in_the_variant_of_the_later_program():
    world = World(WorldConfig(paid="leaving", noise="normal", noise_scale=8.0))
    beside, ice = world.number_of((3, 2)), world.number_of((3, 3))
    assert world.mdp.noise[beside, RIGHT, ice] == 0
    assert world.mdp.noise[ice, LEFT, beside] == 64


def test_a_fifth_of_the_uniform_numbers_slip():
    slots = WORLD.slot(np.array([0.0, 0.0166, 0.0167, 0.1999, 0.2, 0.9999]))
    assert slots.tolist() == [0, 0, 1, 11, 12, 12]  # 0.2 / 12 = 0.01667


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"slip": 1.5}, "--slip is 1.5, expected 0 .. 1"),
        ({"slip": float("nan")}, "--slip is nan, expected a finite number"),
        ({"noise_scale": -1.0}, "--noise-scale is -1.0, expected >= 0"),
    ],
)
def test_a_world_that_is_none_is_refused(settings, sentence):
    with pytest.raises(ValueError, match=re.escape(sentence)):
        WorldConfig(**settings)


def test_arrays_that_are_no_decision_process_are_refused():
    good = {
        "transition": np.full((2, 1, 2), 0.5), "reward": np.zeros((2, 1, 2)),
        "noise": np.zeros((2, 1, 2)), "start": np.array([1.0, 0.0]),
    }  # fmt: skip
    Mdp(**good)
    with pytest.raises(ValueError, match=re.escape("reward has shape (2, 2), expected (2, 1, 2)")):
        Mdp(**good | {"reward": np.zeros((2, 2))})
    with pytest.raises(ValueError, match="sum to 1, or to 0 in a terminal state"):
        Mdp(**good | {"transition": np.full((2, 1, 2), 0.4)})
    with pytest.raises(ValueError, match="start has to be a distribution over the 2 states"):
        Mdp(**good | {"start": np.array([0.5, 0.0])})
