"""The exact state of a MuJoCo environment as named arrays, and back.

MuJoCo's integration state is not all that a Gymnasium environment reads: rewards and observations
also use quantities that the last step left behind (the torso's position before the step, contact
forces, ...). Those are kept beside it; whatever else `mj_step` needs, it computes anew.
"""

import json
from typing import Any

import gymnasium
import mujoco
import numpy as np
from numpy.typing import NDArray

from workers.envs import Env

Arrays = dict[str, NDArray[np.generic]]
_STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION)
_LAGGING = (
    "xpos", "xquat", "xmat", "xipos", "ximat", "geom_xpos", "geom_xmat", "site_xpos", "site_xmat",
    "subtree_com", "subtree_linvel", "cinert", "cvel", "cacc", "cfrc_ext", "cfrc_int",
    "qacc", "qfrc_actuator", "qfrc_constraint", "actuator_force", "sensordata",
)  # fmt: skip


def capture(env: Env) -> Arrays:
    """Everything the environment's future depends on, besides the actions."""
    inner = env.unwrapped
    model, data = inner.model, inner.data  # type: ignore[attr-defined]
    state = np.empty(mujoco.mj_stateSize(model, _STATE))
    mujoco.mj_getState(model, data, state, _STATE)
    generator = json.dumps(inner.np_random.bit_generator.state).encode()
    return {
        "mujoco": state,
        "generator": np.frombuffer(generator, np.uint8),
        "elapsed": np.array([_time_limit(env)], np.int64),
        **{name: getattr(data, name).ravel().copy() for name in _LAGGING},
    }


def restore(env: Env, arrays: Arrays) -> None:
    """Put the environment, which has been reset before, back into a captured state."""
    inner = env.unwrapped
    model, data = inner.model, inner.data  # type: ignore[attr-defined]
    mujoco.mj_setState(model, data, arrays["mujoco"], _STATE)
    for name in _LAGGING:
        field = getattr(data, name)
        field[...] = arrays[name].reshape(field.shape)
    inner.np_random.bit_generator.state = json.loads(arrays["generator"].tobytes())
    _time_limit(env, int(arrays["elapsed"][0]))


def _time_limit(env: Env, steps: int | None = None) -> int:
    """Steps the time limit has counted; set them if given. -1 without a time limit."""
    wrapper: Any = env
    while not isinstance(wrapper, gymnasium.wrappers.TimeLimit):
        if not isinstance(wrapper, gymnasium.Wrapper):
            return -1
        wrapper = wrapper.env
    limit: Any = wrapper  # Gymnasium offers no other way than its private counter
    if steps is not None:
        limit._elapsed_steps = steps
    return int(limit._elapsed_steps or 0)
