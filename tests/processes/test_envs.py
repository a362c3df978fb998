"""Environments by id: made, described by sizes, fed with flat vectors; or refused by name."""

import hashlib
import re
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces

from dppo.config import RunConfig
from dppo.errors import UsageError
from dppo.spaces import Spaces
from workers.envs import Adapter, env_hash, make_env, spaces_of

BOX = spaces.Box(-1, 1, (2,), np.float32)
TEXT = spaces.Text(5)


class Blank(gymnasium.Env):
    """Nothing but its spaces."""

    def __init__(self, observation=BOX, action=BOX):
        self.observation_space, self.action_space = observation, action


def sizes(observation=BOX, action=BOX):
    return spaces_of(Blank(observation, action))


def to_env(action_space, *numbers):
    return Adapter(BOX, action_space).to_env(np.array(numbers, np.float32))


def refuses_to_make(sentence, **run):
    with pytest.raises(UsageError, match=re.escape(sentence)):
        make_env(RunConfig(**run))


def test_an_unknown_id_names_near_ones():
    refuses_to_make(
        "--env is 'HalfCheeta-v4', which Gymnasium does not know; did you mean HalfCheetah-v4",
        env="HalfCheeta-v4",
    )


def test_an_unknown_id_that_is_near_nothing_says_where_to_look():
    refuses_to_make("--env is '~~~', which Gymnasium does not know; see gymn", env="~~~")


def test_a_module_that_cannot_be_imported_is_named():
    refuses_to_make(
        "no_such_module:Mine-v0 cannot be made with {}: ", env="no_such_module:Mine-v0"
    )


def test_a_wrong_keyword_argument_is_named():
    refuses_to_make(
        'Hopper-v5 cannot be made with {"friction": 3}: TypeError: ',
        env="Hopper-v5",
        env_kwargs='{"friction": 3}',
    )


def test_keyword_arguments_reach_the_environment():
    env = make_env(RunConfig(env="CartPole-v1", env_kwargs='{"max_episode_steps": 7}'))
    assert env.spec is not None
    assert env.spec.max_episode_steps == 7


@pytest.mark.parametrize(
    ("env", "found"),
    [
        ("HalfCheetah-v4", Spaces(obs_size=17, action_kind="box", action_sizes=(6,))),
        ("Hopper-v4", Spaces(obs_size=11, action_kind="box", action_sizes=(3,))),
        ("Ant-v4", Spaces(obs_size=27, action_kind="box", action_sizes=(8,))),
        ("CartPole-v1", Spaces(obs_size=4, action_kind="discrete", action_sizes=(2,))),
    ],
)
def test_sizes_of_known_environments(env, found):
    assert spaces_of(make_env(RunConfig(env=env))) == found


@pytest.mark.parametrize(
    ("observation", "size"),
    [
        (spaces.Box(0, 255, (4, 3, 2), np.uint8), 24),
        (spaces.Discrete(5), 5),  # one-hot
        (spaces.MultiDiscrete([2, 3]), 5),
        (spaces.MultiBinary(4), 4),
        (spaces.Dict(near=BOX, far=spaces.Discrete(3)), 5),
        (spaces.Tuple((BOX, spaces.Dict(deep=BOX))), 4),
    ],
)
def test_observations_that_flatten(observation, size):
    assert sizes(observation).obs_size == size
    flat = Adapter(observation, BOX).obs(observation.sample())
    assert flat.shape == (size,)
    assert flat.dtype == np.float64


def test_a_dictionary_flattens_by_key_and_choices_are_one_hot():
    observation = spaces.Dict(b=BOX, a=spaces.Discrete(3, start=1))
    seen = {"a": 2, "b": np.array([0.5, -0.5], np.float32)}
    order = {"a": [0.0, 1.0, 0.0], "b": [0.5, -0.5]}
    expected = [number for key in observation for number in order[key]]
    assert Adapter(observation, BOX).obs(seen).tolist() == expected


def test_a_picture_flattens_row_by_row():
    box = spaces.Box(0, 255, (2, 2), np.uint8)
    assert Adapter(box, BOX).obs(np.array([[1, 2], [3, 4]], np.uint8)).tolist() == [1, 2, 3, 4]


@pytest.mark.parametrize(
    "observation",
    [
        TEXT, spaces.Dict(a=BOX, note=TEXT), spaces.Tuple((BOX, TEXT)), spaces.Sequence(BOX),
        spaces.Dict(a=spaces.Sequence(BOX)), spaces.Graph(BOX, None),
    ],
    ids=lambda space: type(space).__name__,
)  # fmt: skip
def test_an_observation_that_is_no_vector_is_refused_by_name(observation):
    sentence = (
        f"Blank has observation space {observation}, which cannot be flattened into a vector"
    )
    with pytest.raises(UsageError, match=re.escape(sentence)):
        sizes(observation)


@pytest.mark.parametrize(
    ("action", "found"),
    [
        (spaces.Box(-1, 1, (2, 3), np.float64), ("box", (6,))),
        (spaces.Discrete(4, start=-2), ("discrete", (4,))),
        (spaces.MultiDiscrete(np.array([[2, 3], [4, 5]])), ("discrete", (2, 3, 4, 5))),
    ],
)
def test_sizes_of_actions(action, found):
    described = sizes(action=action)
    assert (described.action_kind, described.action_sizes) == found


def test_sizes_that_follow_from_sizes():
    box = Spaces(obs_size=1, action_kind="box", action_sizes=(3,))
    choices = Spaces(obs_size=1, action_kind="discrete", action_sizes=(2, 3, 4))
    assert (box.action_size, box.output_size) == (3, 3)
    assert (choices.action_size, choices.output_size) == (3, 9)


@pytest.mark.parametrize(
    "action",
    [
        spaces.MultiBinary(3), spaces.Box(0, 9, (2,), np.int32), spaces.Box(-1, 1, (), np.float32),
        spaces.Dict(a=BOX), spaces.Tuple((BOX,)), TEXT,
    ],
    ids=str,
)  # fmt: skip
def test_an_unsupported_action_is_refused_by_name(action):
    sentence = f"Blank has action space {action}; supported are Box of floats, Discrete and Multi"
    with pytest.raises(UsageError, match=re.escape(sentence)):
        sizes(action=action)


def test_a_box_action_is_clipped_at_its_border():
    low, high = np.array([[-1, -2, 0], [1, np.inf, 0.5]], np.float32)
    box = spaces.Box(low, high, dtype=np.float32)
    found = to_env(box, 3.0, 1e6, -0.1)
    assert found.tolist() == [1.0, 1e6, 0.0]
    assert found.dtype == np.float32
    assert box.contains(found)


def test_a_box_action_takes_the_shape_and_type_of_its_space():
    box = spaces.Box(-1, 1, (2, 2), np.float64)
    found = to_env(box, 0.5, -0.5, 2.0, -2.0)
    assert found.tolist() == [[0.5, -0.5], [1.0, -1.0]]
    assert box.contains(found)


def test_the_policy_keeps_its_unclipped_action():
    action = np.array([3.0, -3.0], np.float32)
    Adapter(BOX, BOX).to_env(action)
    assert action.tolist() == [3.0, -3.0]


def test_a_discrete_action_counts_from_its_start():
    found = to_env(spaces.Discrete(3, start=10), 2.0)
    assert found == 12
    assert type(found) is int


def test_a_multi_discrete_action_counts_from_its_starts():
    space = spaces.MultiDiscrete(np.array([[2, 3], [4, 5]]), start=np.array([[0, 10], [20, 30]]))
    found = to_env(space, 1.0, 2.0, 0.0, 4.0)
    assert found.tolist() == [[1, 12], [20, 34]]
    assert space.contains(found)


def test_the_hash_of_an_environment_is_that_of_its_model_file():
    env = make_env(RunConfig(env="Hopper-v5"))
    xml = Path(gymnasium.__file__).parent / "envs" / "mujoco" / "assets" / "hopper.xml"
    assert env_hash(env) == hashlib.sha256(xml.read_bytes()).hexdigest()
    assert env_hash(make_env(RunConfig(env="CartPole-v1"))) == ""
