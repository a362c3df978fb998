"""One vector environment against another, to the bit, under random actions and trained policies.

Trained policies in `tests/data/trained_policies.safetensors`; how they were made is beside them.
"""

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from safetensors.numpy import load_file

from workers.envs import make_vec
from workers.mujoco_vec import MujocoVec

POLICIES = Path(__file__).parent / "data" / "trained_policies.safetensors"


def pair(env_id, num_envs, mode, **kwargs):
    """Gymnasium's own vector environment, and ours."""
    own = gymnasium.make_vec(
        env_id,
        num_envs,
        vectorization_mode="sync",
        vector_kwargs={"autoreset_mode": mode},
        **kwargs,
    )
    ours = make_vec(env_id, num_envs, autoreset_mode=mode, **kwargs)
    assert isinstance(ours, MujocoVec)
    return own, ours


def assert_same(one, other, where=""):
    """Equal to the bit, types, keys and masks included."""
    if isinstance(one, dict):
        assert one.keys() == other.keys(), where
        for name in one:
            assert_same(one[name], other[name], f"{where}/{name}")
    elif isinstance(one, tuple) or (isinstance(one, np.ndarray) and one.dtype == object):
        for number, (a, b) in enumerate(zip(one, other, strict=True)):
            assert_same(a, b, f"{where}/{number}")
    elif one is None:
        assert other is None, where
    else:
        a, b = np.asarray(one), np.asarray(other)
        assert (a.dtype, a.shape) == (b.dtype, b.shape), where
        assert a.tobytes() == b.tobytes(), f"{where}: {a} {b}"


def compare(env_id, steps, actions, num_envs=3, mode=AutoresetMode.SAME_STEP, **kwargs):
    """Step both; the number of episodes that ended."""
    own, ours = pair(env_id, num_envs, mode, **kwargs)
    seeds = list(range(5, 5 + num_envs))
    obs, infos = own.reset(seed=seeds)
    assert_same((obs, infos), ours.reset(seed=seeds), f"{env_id} reset")
    ends = 0
    for step in range(steps):
        action = actions(step, obs)
        result = own.step(action)
        assert_same(result, ours.step(action), f"{env_id} step {step}")
        obs, ended = result[0], result[2] | result[3]
        ends += int(ended.sum())
        if mode is AutoresetMode.DISABLED and ended.any():
            again = {"seed": [step + row for row in range(num_envs)]}
            obs, infos = own.reset(**again, options={"reset_mask": ended.copy()})
            found = ours.reset(**again, options={"reset_mask": ended.copy()})
            assert_same((obs, infos), found, f"{env_id} reset {step}")
    own.close()
    ours.close()
    return ends


def random_actions(env_id, scale=0.8, seed=0):
    """Of all sizes, some beyond the bounds."""
    space: Any = gymnasium.make(env_id).action_space
    rng = np.random.default_rng(seed)

    def act(_step, obs):
        return (space.high * rng.normal(0, scale, (len(obs), *space.shape))).astype(np.float32)

    return act


def trained_actions(env_id, seed=0):
    """Sampled from the trained policy of one of Gymnasium's own ids, a tanh network."""
    arrays = load_file(POLICIES)
    mean, scale, *layers = (arrays[f"{env_id}/{n}"] for n in range(9))
    log_std, rng = layers.pop(), np.random.default_rng(seed)

    def act(_step, obs):
        x = np.clip((obs - mean) / scale, -10, 10)
        for index in range(0, len(layers), 2):
            x = x @ layers[index] + layers[index + 1]
            x = np.tanh(x) if index < len(layers) - 2 else x
        noise = np.exp(log_std) * rng.normal(size=x.shape)
        return (x + noise).astype(np.float32)

    return act
