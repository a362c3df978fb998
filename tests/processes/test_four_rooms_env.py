"""`FourRooms-v0` as a Gymnasium environment."""

import re
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from dppo.config import RunConfig
from dppo.errors import UsageError
from dppo.four_rooms.world import World, WorldConfig
from dppo.spaces import Spaces
from workers import four_rooms
from workers.envs import Adapter, exactness, make_env, spaces_of

ID = "workers.four_rooms:FourRooms-v0"
VARIANTS: tuple[dict[str, Any], ...] = (
    {}, {"slip_to": "actions"}, {"noise": "normal", "noise_scale": 8.0, "paid": "leaving"},
    {"slip": 0.0},
)  # fmt: skip


@pytest.mark.parametrize("variant", VARIANTS, ids=str)
@pytest.mark.parametrize("mode", ["rgb_array", "ansi"])
def test_it_passes_the_checker_of_gymnasium(variant, mode):
    check_env(gymnasium.make(ID, render_mode=mode, **variant).unwrapped)


def test_registering_twice_changes_nothing():
    before = gymnasium.registry["FourRooms-v0"]
    four_rooms.register()
    assert gymnasium.registry["FourRooms-v0"] is before


def test_the_trainer_makes_it_by_its_bare_name_and_sees_104_numbers():
    env = make_env(RunConfig(env="FourRooms-v0", env_kwargs='{"slip_to": "actions"}'))
    assert spaces_of(env) == Spaces(obs_size=104, action_kind="discrete", action_sizes=(4,))
    observation, _ = env.reset(seed=0)
    seen = Adapter(env.observation_space, env.action_space).obs(observation)
    assert seen.tolist() == np.eye(104)[observation].tolist()
    assert exactness(env, wanted=True) == "replayed"


def test_a_wrong_variant_is_refused_in_a_sentence():
    sentence = "FourRooms-v0 cannot be made with"
    with pytest.raises(UsageError, match=re.escape(sentence)):
        make_env(RunConfig(env="FourRooms-v0", env_kwargs='{"slip": 3}'))


def test_an_episode_is_cut_after_500_steps():
    env = gymnasium.make(ID, slip=0.0)
    env.reset(seed=0, options={"cell": 0})
    ends = [env.step(0)[2:4] for _ in range(500)]  # up, into a wall
    assert ends[:-1] == [(False, False)] * 499
    assert ends[-1] == (False, True)


def test_the_goal_ends_the_episode_with_50():
    world = World()
    env = gymnasium.make(ID, slip=0.0)
    env.reset(options={"cell": world.number_of((6, 9))})
    cell, reward, terminated, truncated, _ = env.step(1)
    assert (cell, reward, terminated, truncated) == (world.goal, 50.0, True, False)


def test_an_episode_may_begin_in_a_chosen_cell_but_not_in_the_goal():
    env = gymnasium.make(ID)
    assert env.reset(options={"cell": 7})[0] == 7
    with pytest.raises(ValueError, match=re.escape("options['cell'] is 62, expected a cell from")):
        env.reset(options={"cell": 62})


def test_ice_pays_between_minus_15_and_15_when_it_is_entered():
    world = World(WorldConfig(slip=0.0))
    env = gymnasium.make(ID, slip=0.0)
    env.reset(seed=0)
    beside = {"cell": world.number_of((3, 2))}
    rewards = []
    for _ in range(200):
        env.reset(options=beside)
        _, reward, _, _, facts = env.step(3)
        assert facts == {"frozen": True}
        rewards.append(float(reward))
    assert -15 <= min(rewards) < -13 < 13 < max(rewards) <= 15
    env.reset(options={"cell": world.number_of((2, 5))})
    assert env.step(3)[1] == 0  # a wall beside the ice


def test_equal_seeds_and_actions_give_equal_episodes():
    def episode(seed):
        env = gymnasium.make(ID)
        first, _ = env.reset(seed=seed)
        return [first, *(env.step(step % 4)[:2] for step in range(50))]

    assert episode(5) == episode(5) != episode(6)


def test_the_map_as_text_has_one_agent():
    env = gymnasium.make(ID, render_mode="ansi")
    env.reset(options={"cell": 0})
    text = env.render()
    assert isinstance(text, str)
    assert text.splitlines()[1] == "wA    w     w"
    assert text.count("A") == 1
    assert text.count("G") == 1


def test_the_map_as_a_picture_is_thirteen_cells_of_sixteen_pixels():
    env = gymnasium.make(ID, render_mode="rgb_array")
    env.reset(options={"cell": 0})
    picture = env.render()
    assert isinstance(picture, np.ndarray)
    assert picture.shape == (208, 208, 3)
    assert picture.dtype == np.uint8
    assert picture[16, 16].tolist() == [213, 94, 0]
