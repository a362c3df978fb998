"""Recorded actions and the states they lead through, so that all cases step the same physics."""

import math
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Self

import gymnasium
import mujoco
import numpy as np
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from numpy.typing import NDArray

from dppo.config import Config

ActionKind = Literal["mild", "random", "policy"]
"""Normal noise of .3 of the border; uniform; what an untrained policy of dppo does."""
Float64 = NDArray[np.float64]


@dataclass(frozen=True)
class Recording:
    """K steps of n environments. Shape letters: K, n · A actions · q numbers of (qpos, qvel)."""

    env: str
    action: NDArray[np.float32]  # [K, n, A]
    ended: NDArray[np.bool_]  # [K, n]  the environment was reset right after this step
    start: Float64  # [n, q]  states after the first reset
    restart: Float64  # [resets, q]  states after the others, in order
    last: Float64  # [n, q]  states at the end
    last_obs: Float64  # [n, O]  what gymnasium observed there

    @property
    def steps(self) -> int:
        """Environment steps in it."""
        return int(self.ended.size)

    def save(self, file: Path) -> None:
        """As .npz."""
        np.savez(file, **self.__dict__)

    @classmethod
    def load(cls, file: Path) -> Self:
        """The inverse of `save`."""
        arrays = np.load(file)
        return cls(**{**arrays, "env": str(arrays["env"])})


def quiet() -> None:
    """Keep Gymnasium's and MuJoCo's remarks on old environments out of the output."""
    gymnasium.logger.min_level = gymnasium.logger.ERROR
    mujoco.set_mju_user_warning(lambda _: None)


def sync_vector(env_id: str, num_envs: int) -> SyncVectorEnv:
    """Gymnasium's own vector environment, which resets within the step that ends an episode."""
    quiet()
    kwargs = {"autoreset_mode": AutoresetMode.SAME_STEP}
    envs = gymnasium.make_vec(env_id, num_envs, vectorization_mode="sync", vector_kwargs=kwargs)
    assert isinstance(envs, SyncVectorEnv)
    return envs


def seeds(num_envs: int) -> list[int | None]:
    """Of the first reset of every environment."""
    return list(range(1, num_envs + 1))


def record(
    env_id: str, num_envs: int, kind: ActionKind, seconds: float, most: int = 4000
) -> Recording:
    """Step gymnasium's environments for about `seconds`, at most `most` steps each."""
    envs = sync_vector(env_id, num_envs)
    space = envs.single_action_space
    assert isinstance(space, gymnasium.spaces.Box)
    rng = np.random.default_rng(0)
    envs.reset(seed=seeds(num_envs))
    start = _states(envs)
    actions: list[NDArray[np.float32]] = []
    ends: list[NDArray[np.bool_]] = []
    restarts: list[Float64] = []
    until = time.perf_counter() + seconds
    while len(actions) < most and (not actions or time.perf_counter() < until):
        action = _actions(rng, kind, num_envs, space)
        obs, _, terminated, truncated, _ = envs.step(action)
        ended = terminated | truncated
        actions.append(action)
        ends.append(ended)
        if ended.any():
            restarts.append(_states(envs)[ended])
    last = _states(envs)
    envs.close()
    restart = np.concatenate(restarts) if restarts else np.empty((0, start.shape[1]))
    return Recording(env_id, np.array(actions), np.array(ends), start, restart, last, obs)


def _actions(
    rng: np.random.Generator, kind: ActionKind, num_envs: int, space: gymnasium.spaces.Box
) -> NDArray[np.float32]:
    shape = (num_envs, *space.shape)
    if kind == "random":
        return rng.uniform(space.low, space.high, shape).astype(np.float32)
    untrained = math.exp(Config().network.log_std_init)
    spread = 0.3 * space.high if kind == "mild" else untrained
    action = np.clip(spread * rng.standard_normal(shape), space.low, space.high)
    return action.astype(np.float32)


def _states(envs: SyncVectorEnv) -> Float64:
    """[n, q] positions and velocities."""
    inner: list[Any] = [env.unwrapped for env in envs.envs]
    return np.stack([np.concatenate([env.data.qpos, env.data.qvel]) for env in inner])
