"""Environments: made by id, alone or n at a time, described by sizes, refused by name."""

import difflib
import hashlib
import json
import logging
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from dppo.action_spaces import SUPPORTED, kind_and_sizes
from dppo.config import RunConfig
from dppo.errors import UsageError
from dppo.spaces import Spaces
from workers import four_rooms, hazards  # noqa: F401  importing them registers their ids
from workers.generic_vec import GenericVec
from workers.hazardous_vec import HazardousVec
from workers.heart import beat
from workers.kinds import kind_of
from workers.mujoco_vec import MujocoVec

Env = gymnasium.Env[Any, Any]
Exactness = Literal["captured", "replayed", "off"]
Vec = MujocoVec | GenericVec
_TRANSPARENT = (
    gymnasium.wrappers.TimeLimit,
    gymnasium.wrappers.OrderEnforcing,
    gymnasium.wrappers.PassiveEnvChecker,
    hazards.Hazardous,
)
"""Wrappers whose whole state a snapshot holds."""


def make_env(config: RunConfig) -> Env:
    """The environment of a run.

    Raises:
        UsageError: unknown id (with near names), wrong keyword arguments, missing packages.
    """
    beat()  # many may take long
    known = sorted(gymnasium.registry)
    name = config.env.rpartition(":")[2]
    if ":" not in config.env and name not in known:
        near = difflib.get_close_matches(name, known, n=3, cutoff=0.5)
        hint = f"did you mean {', '.join(near)}?" if near else "see gymnasium.registry"
        raise UsageError(f"--env is {config.env!r}, which Gymnasium does not know; {hint}")
    if ":" in config.env and (here := str(Path.cwd())) not in sys.path:
        sys.path.append(here)  # last: nothing there takes the place of what is installed
    try:
        return _make(config.env, json.loads(config.env_kwargs))
    except Exception as error:  # an environment's constructor may raise anything
        raise UsageError(
            f"{config.env} cannot be made with {config.env_kwargs}: "
            f"{type(error).__name__}: {error}"
        ) from error


def make_vec(
    env_id: str,
    num_envs: int,
    *,
    autoreset_mode: AutoresetMode = AutoresetMode.NEXT_STEP,
    snapshots: bool = True,
    **kwargs: Any,  # noqa: ANN401  the environment's own
) -> Vec:
    """`num_envs` environments in one vector environment, at the speed of physics where possible.

    Gymnasium's own MuJoCo environments, -v4 and -v5, are batched: the same bits as Gymnasium's
    in observations, rewards, ends and infos, 1.5 to 2 times as fast. Any other id, or one that
    renders, is stepped one environment after the other.

    Besides `reset(seed=[...])` and `step(actions)`, both have `snapshot()` and `restore()`: exact
    for MuJoCo, by replaying for others, whose `is_exact(row)` tells whether that worked.

    Args:
        env_id: Gymnasium id.
        num_envs: n.
        autoreset_mode: when rows whose episode ended begin anew; as in Gymnasium.
        snapshots: False: a row that is moved by replaying remembers nothing and cannot be moved.
            Otherwise it remembers all actions since its last reset with a seed.
        kwargs: of the environment, as for gymnasium.make.

    Example:
        vec = make_vec("Ant-v4", 16, ctrl_cost_weight=0.1)
        obs, _ = vec.reset(seed=list(range(16)))
        obs, reward, terminated, truncated, info = vec.step(vec.action_space.sample())
    """
    if num_envs < 1:
        raise ValueError(f"num_envs is {num_envs}, expected >= 1")
    return _vec(
        _make(env_id, kwargs),
        lambda: _make(env_id, kwargs),
        num_envs,
        autoreset_mode=autoreset_mode,
        infos=True,
        remember=snapshots,
    )


def training_vec(config: RunConfig, num_envs: int, remember: bool) -> Vec:
    """What a slot's environments are: flat observations, no infos, reset by the trainer alone.

    Args:
        config: of the run.
        num_envs: n.
        remember: how rows came to where they are, for snapshots.
    """
    return _vec(
        _flat(make_env(config)),
        lambda: _flat(make_env(config)),
        num_envs,
        autoreset_mode=AutoresetMode.DISABLED,
        infos=False,
        remember=remember,
    )


def _vec(
    first: Env,
    another: Callable[[], Env],
    num_envs: int,
    *,
    autoreset_mode: AutoresetMode,
    infos: bool,
    remember: bool,
) -> Vec:
    """Batched if the first environment is of a kind that can be, else one after the other."""
    kind = kind_of(first.unwrapped) if exactness(first, True) == "captured" else None
    if kind is not None and first.render_mode is None:
        hazard = hazards.hazard_of(first)
        if hazard == hazards.Hazard():
            return MujocoVec(first, kind, num_envs, autoreset_mode, infos)
        return HazardousVec(first, kind, num_envs, autoreset_mode, infos, hazard)
    envs = [first, *(another() for _ in range(num_envs - 1))]
    return GenericVec(envs, autoreset_mode, infos, remember)


def _make(env_id: str, kwargs: dict[str, Any]) -> Env:
    return gymnasium.make(env_id, disable_env_checker=True, **kwargs)


def _flat(env: Env) -> Env:
    """With observations that are vectors."""
    if isinstance(env.observation_space, spaces.Box):
        return env
    return gymnasium.wrappers.FlattenObservation(env)


def name_of(env: Env | gymnasium.vector.VectorEnv[Any, Any, Any]) -> str:
    """Its id, or its class where it was made without one."""
    return env.spec.id if env.spec else type(env).__name__


def spaces_of(env: Env) -> Spaces:
    """Sizes of an environment's spaces.

    Raises:
        UsageError: spaces that the trainer does not support, named.
    """
    observation, action = env.observation_space, env.action_space
    name = name_of(env)
    if not _is_vector(observation):
        raise UsageError(
            f"{name} has observation space {observation}, which cannot be flattened into a "
            "vector; supported are Box, Discrete, MultiDiscrete, MultiBinary, and Dict and Tuple "
            "of these"
        )
    size = spaces.flatdim(observation)
    found = kind_and_sizes(action)
    if found is None:
        raise UsageError(f"{name} has action space {action}; supported are {SUPPORTED}")
    kind, sizes = found
    return Spaces(obs_size=size, action_kind=kind, action_sizes=sizes)


def _is_vector(space: spaces.Space[Any]) -> bool:
    """Can observations of this space be flattened into numbers that mean something?"""
    match space:
        case spaces.Dict():
            return all(_is_vector(part) for part in space.spaces.values())
        case spaces.Tuple():
            return all(_is_vector(part) for part in space.spaces)
    return isinstance(
        space, spaces.Box | spaces.Discrete | spaces.MultiDiscrete | spaces.MultiBinary
    )


@dataclass(frozen=True)
class Adapter:
    """Between an environment's spaces and flat vectors."""

    observation: spaces.Space[Any]
    action: spaces.Space[Any]

    @cached_property
    def obs_size(self) -> int:
        """O: numbers per flattened observation."""
        return spaces.flatdim(self.observation)

    @property
    def action_size(self) -> int:
        """A: numbers per action."""
        return int(np.prod(self.action.shape or (1,)))

    @cached_property
    def _bounds(self) -> tuple[NDArray[Any], NDArray[Any]]:
        """Of a Box: looking them up takes as long as using them."""
        assert isinstance(self.action, spaces.Box)
        return self.action.low, self.action.high

    def obs(self, observation: Any) -> NDArray[np.float64]:  # noqa: ANN401  any space
        """[O] flattened observation."""
        if isinstance(self.observation, spaces.Box):
            return np.asarray(observation, np.float64).reshape(-1)
        return np.asarray(spaces.flatten(self.observation, observation), np.float64)

    def to_env(self, action: NDArray[np.float32]) -> Any:  # noqa: ANN401  any space
        """The environment's action from [A]: clipped at its border, or whole numbers."""
        chosen = self.to_envs(action[None])[0]
        return int(chosen) if isinstance(self.action, spaces.Discrete) else chosen

    def to_envs(self, action: NDArray[np.float32]) -> NDArray[Any]:
        """The actions of n environments from [n, A]; see `to_env`."""
        match self.action:
            case spaces.Box() as box:
                low, high = self._bounds
                bounded = np.minimum(np.maximum(action.reshape(-1, *box.shape), low), high)
                return np.asarray(bounded, box.dtype)
            case spaces.Discrete() as discrete:
                return np.asarray(discrete.start + action[:, 0].astype(np.int64))
            case spaces.MultiDiscrete() as multi:
                chosen = action.astype(np.int64).reshape(-1, *multi.nvec.shape)
                return (multi.start + chosen).astype(multi.dtype, copy=False)
        raise AssertionError(f"spaces_of lets no {self.action} through")


def exactness(env: Env, wanted: bool) -> Exactness:
    """How this environment moves from process to process without losing a bit.

    captured: Gymnasium's own MuJoCo environments, also with a hazard, whose state MuJoCo can give
    and take.
    replayed: any other, from its reset seed and the actions so far.
    """
    if not wanted:
        return "off"
    wrapper: Any = env
    while isinstance(wrapper, gymnasium.Wrapper):
        if not isinstance(wrapper, _TRANSPARENT):
            return "replayed"
        wrapper = wrapper.env
    ours = type(wrapper).__module__.startswith("gymnasium.envs.mujoco.")
    return "captured" if ours else "replayed"


def env_hash(env: Env) -> str:
    """SHA-256 of the MuJoCo model's XML; empty for other environments."""
    path = getattr(env.unwrapped, "fullpath", None)
    if path is None:
        return ""
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()


def quiet() -> None:
    """Keep Gymnasium's and MuJoCo's remarks out of the output and of the working directory."""
    gymnasium.logger.min_level = gymnasium.logger.ERROR
    try:
        import mujoco  # not every environment needs it
    except ImportError:
        return
    mujoco.set_mju_user_warning(lambda text: logging.getLogger("mujoco").info("%s", text))
