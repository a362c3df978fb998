"""Batched MuJoCo environments against Gymnasium's own: every bit, over episodes and resets."""

from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from tests.bits import assert_same, compare, pair, random_actions, trained_actions
from workers.envs import make_vec
from workers.generic_vec import GenericVec
from workers.mujoco_vec import MujocoVec
from workers.simulations import Batched, OneByOne, has_batch

NAMES = (
    "Ant", "HalfCheetah", "Hopper", "Walker2d", "Humanoid", "HumanoidStandup", "Swimmer",
    "InvertedPendulum", "InvertedDoublePendulum", "Reacher", "Pusher",
)  # fmt: skip

pytestmark = pytest.mark.usefixtures("quiet_libraries")
IDS = [f"{name}-{version}" for name in NAMES for version in ("v4", "v5")]
IDS.remove("Pusher-v4")  # Gymnasium refuses it on MuJoCo 3 and later
KWARGS = [
    ("Ant-v4", {"use_contact_forces": True, "terminate_when_unhealthy": False}),
    ("Ant-v4", {"exclude_current_positions_from_observation": False, "ctrl_cost_weight": 0.1}),
    ("Ant-v5", {"include_cfrc_ext_in_observation": False, "main_body": "aux_1"}),
    ("Ant-v5", {"frame_skip": 2, "healthy_reward": 0.5, "contact_cost_weight": 1e-3}),
    ("HalfCheetah-v5", {"forward_reward_weight": 2.0, "reset_noise_scale": 0.3}),
    ("Hopper-v4", {"terminate_when_unhealthy": False, "healthy_angle_range": (-0.1, 0.3)}),
    ("Hopper-v5", {"healthy_state_range": (-5.0, 5.0)}),
    ("Humanoid-v5", {"include_cvel_in_observation": False, "contact_cost_range": (0.0, 1.0)}),
    ("Humanoid-v5", {"include_qfrc_actuator_in_observation": False}),
    ("HumanoidStandup-v5", {"ctrl_cost_weight": 0.5, "impact_cost_weight": 1e-4}),
    ("InvertedDoublePendulum-v5", {"healthy_reward": 3.0}),
    ("Pusher-v5", {"reward_near_weight": 1.5}),
    ("Reacher-v5", {"reward_control_weight": 0.5}),
    ("Swimmer-v4", {"exclude_current_positions_from_observation": False}),
    ("Walker2d-v4", {"terminate_when_unhealthy": False}),
    ("Walker2d-v5", {"ctrl_cost_weight": 0.5, "healthy_z_range": (1.2, 1.3)}),
]


def trace(env_id, **kwargs):
    """All that Gymnasium's own environments give in 40 steps, as bytes."""
    own: Any = gymnasium.make_vec(env_id, 3, "sync", max_episode_steps=30, **kwargs)
    act = random_actions(env_id)
    obs, _ = own.reset(seed=[5, 6, 7])
    found = [obs.tobytes()]
    for step in range(40):
        obs, *others, _ = own.step(act(step, obs))
        found += [array.tobytes() for array in (obs, *others)]
    own.close()
    return found


@pytest.mark.parametrize("env_id", IDS)
def test_a_batched_environment_has_gymnasiums_bits(env_id):
    assert compare(env_id, 60, random_actions(env_id), max_episode_steps=25) > 0


@pytest.mark.parametrize("env_id", ["Ant-v4", "Hopper-v5", "Reacher-v4", "Walker2d-v5"])
def test_without_mujocos_own_batch_the_bits_are_the_same(env_id, monkeypatch):
    """As with a MuJoCo that has none."""
    monkeypatch.setattr("workers.simulations.has_batch", lambda: False)
    assert compare(env_id, 60, random_actions(env_id), max_episode_steps=25) > 0


@pytest.mark.parametrize(
    ("env_id", "way"),
    [("Ant-v4", Batched), ("InvertedDoublePendulum-v5", Batched), ("Ant-v5", OneByOne)],
)
def test_contact_forces_alone_need_a_call_for_each_environment(env_id, way):
    if not has_batch():
        pytest.skip("this MuJoCo has no batch")
    vec = make_vec(env_id, 2)
    assert isinstance(vec, MujocoVec)
    assert isinstance(vec._simulations, way)


@pytest.mark.parametrize("mode", AutoresetMode)
@pytest.mark.parametrize("env_id", ["Hopper-v5", "Ant-v4"])
def test_rows_begin_anew_as_gymnasiums_do(env_id, mode):
    assert compare(env_id, 120, random_actions(env_id), mode=mode, max_episode_steps=40) > 3


@pytest.mark.parametrize(("env_id", "kwargs"), KWARGS, ids=str)
def test_keyword_arguments_are_honoured(env_id, kwargs):
    compare(env_id, 40, random_actions(env_id), max_episode_steps=30, **kwargs)


@pytest.mark.slow
@pytest.mark.parametrize(("env_id", "kwargs"), KWARGS, ids=str)
def test_each_of_these_keyword_arguments_changes_what_happens(env_id, kwargs):
    """So the test above shows of each one that it is honoured."""
    whole = trace(env_id, **kwargs)
    without = {name: {n: v for n, v in kwargs.items() if n != name} for name in kwargs}
    assert [name for name, rest in without.items() if trace(env_id, **rest) == whole] == []


def test_actions_of_double_precision_keep_their_precision():
    def act(step, obs):
        return np.random.default_rng(step).normal(0, 0.5, (len(obs), 8))

    compare("Ant-v5", 50, act)


def test_the_order_of_actions_in_memory_does_not_matter():
    compare("Ant-v4", 40, lambda step, obs: np.asfortranarray(random_actions("Ant-v4")(step, obs)))


@pytest.mark.parametrize("env_id", ["InvertedPendulum-v5", "HalfCheetah-v5"])
def test_a_row_that_is_cut_off_leaves_the_rows_beside_it_alone(env_id):
    own, ours = pair(env_id, 3, AutoresetMode.SAME_STEP, max_episode_steps=9)
    mask = np.array([False, True, False])
    for vec in (own, ours):
        vec.reset(seed=[1, 2, 3])
    for step in range(30):
        action = np.zeros(own.action_space.shape, np.float32)
        assert_same(own.step(action), ours.step(action), f"step {step}")
        if step == 4:  # from here on the rows end at different times
            results = [
                vec.reset(seed=7, options={"reset_mask": mask.copy()}) for vec in (own, ours)
            ]
            assert_same(results[0][0], results[1][0])


def test_stepping_past_an_end_before_a_reset_or_with_a_wrong_shape_is_refused():
    vec = make_vec("Hopper-v5", 2, autoreset_mode=AutoresetMode.DISABLED, max_episode_steps=2)
    action = np.zeros((2, 3), np.float32)
    with pytest.raises(gymnasium.error.ResetNeeded, match=r"rows \[0, 1\] have no episode"):
        vec.step(action)
    vec.reset(seed=[1, 2])
    with pytest.raises(ValueError, match=r"actions have shape \(3,\), expected \(2, 3\)"):
        vec.step(np.zeros(3))
    vec.step(action)
    assert vec.step(action)[3].all()
    with pytest.raises(gymnasium.error.ResetNeeded, match=r"call reset, with reset_mask"):
        vec.step(action)


@pytest.mark.slow
@pytest.mark.parametrize("env_id", IDS)
def test_ten_thousand_random_steps_have_gymnasiums_bits(env_id):
    assert compare(env_id, 1250, random_actions(env_id), num_envs=8) > 0


@pytest.mark.slow
@pytest.mark.parametrize("env_id", IDS)
def test_ten_thousand_steps_of_a_trained_policy_have_gymnasiums_bits(env_id):
    mode = AutoresetMode.DISABLED
    assert compare(env_id, 1250, trained_actions(env_id), num_envs=8, mode=mode) > 0


@pytest.mark.parametrize("env_id", ["Ant-v5", "Humanoid-v4", "Hopper-v5", "Reacher-v4"])
def test_a_row_goes_on_elsewhere_from_its_snapshot(env_id):
    here, there = (make_vec(env_id, 2, max_episode_steps=30) for _ in range(2))
    act = random_actions(env_id)
    obs, _ = here.reset(seed=[1, 2])
    there.reset(seed=[8, 9])
    ends = 0
    for step in range(70):  # past ends and unseeded resets
        if step % 10 == 0 or ends:  # also in the moment between an end and the new episode
            there.restore(here.snapshot([1, 0]), [0, 1])  # rows change places
        action = act(step, obs)
        expected, found = here.step(action), there.step(action[::-1])
        assert_same(tuple(x[::-1] for x in expected[:4]), found[:4], f"step {step}")
        infos = {name: values[::-1] for name, values in expected[4].items()}
        assert_same(infos, found[4], f"step {step}")
        obs, ends = expected[0], int((expected[2] | expected[3]).sum())


def test_a_row_does_not_depend_on_the_rows_beside_it():
    alone, among = make_vec("Walker2d-v4", 1), make_vec("Walker2d-v4", 5)
    act = random_actions("Walker2d-v4")
    obs, _ = among.reset(seed=list(range(5)))
    assert_same(obs[3:4], alone.reset(seed=[3])[0])
    for step in range(80):
        action = act(step, obs)
        together, single = among.step(action), alone.step(action[3:4])
        assert_same(tuple(x[3:4] for x in together[:4]), single[:4], f"step {step}")
        obs = together[0]


def test_other_environments_and_those_that_render_are_stepped_one_by_one():
    assert isinstance(make_vec("CartPole-v1", 2), GenericVec)
    assert isinstance(make_vec("Hopper-v5", 2, render_mode="rgb_array"), GenericVec)
    wrapped = make_vec("Hopper-v5", 2, max_episode_steps=7)
    assert isinstance(wrapped, MujocoVec)


def test_a_wrong_number_of_seeds_or_environments_is_refused():
    with pytest.raises(ValueError, match="3 seeds for 2 environments; give one for each"):
        make_vec("Hopper-v5", 2).reset(seed=[1, 2, 3])
    with pytest.raises(ValueError, match="num_envs is 0, expected >= 1"):
        make_vec("Hopper-v5", 0)
