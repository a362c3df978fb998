"""Any Gymnasium environment, n at a time: what `make_vec` gives for ids that are not MuJoCo's own.

An environment that cannot be captured is moved by replaying it: from the seed of its last seeded
reset, with all that was done since.
"""

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from numpy.typing import NDArray

from workers.failures import RowFailedError
from workers.heart import beat
from workers.snapshots import Arrays

Env = gymnasium.Env[Any, Any]


class _Watched(gymnasium.Wrapper[Any, Any, Any, Any]):
    """One row: names itself when it fails, and remembers how it came to where it is."""

    def __init__(self, env: Env, row: int, infos: bool, remember: bool) -> None:
        super().__init__(env)
        self._row, self._infos, self._remember = row, infos, remember
        self.exact = True
        self.seed: int | None = None
        self.actions: list[NDArray[Any]] = []
        """Since the last seeded reset."""
        self.resets: list[int] = []
        """How many actions came before each unseeded reset since then."""
        self.obs: Any = None

    def itself(self) -> "_Watched":
        """What SyncVectorEnv calls to make an environment."""
        return self

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """As the environment's."""
        beat()
        if seed is not None:
            self.seed, self.actions, self.resets = seed, [], []
        elif self._remember:
            self.resets.append(len(self.actions))
        try:
            self.obs, info = self.env.reset(seed=seed, options=options or None)
        except Exception as error:  # an environment may raise anything
            raise self._failed(f"raised {type(error).__name__} in reset: {error}") from error
        self._check()
        return self.obs, info if self._infos else {}

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:  # noqa: ANN401
        """As the environment's."""
        beat()
        if self._remember:
            self.actions.append(np.array(action))
        try:
            self.obs, reward, terminated, truncated, info = self.env.step(action)
            facts = float(reward), bool(terminated), bool(truncated)
        except Exception as error:  # an environment may raise anything
            raise self._failed(f"raised {type(error).__name__}: {error}") from error
        self._check()
        told = info if self._infos else {}
        return self.obs, *facts, told

    def replay(self, seed: int, actions: Sequence[Any], resets: Sequence[int]) -> None:
        """Go to where these led."""
        self.reset(seed=seed)
        done = 0
        for number in resets:
            for action in actions[done:number]:
                self.step(action)
            self.reset()
            done = number
        for action in actions[done:]:
            self.step(action)

    def _check(self) -> None:
        """An observation of another size would not fit beside the others."""
        space = self.observation_space
        if isinstance(space, gymnasium.spaces.Box) and np.shape(self.obs) != space.shape:
            raise self._failed(
                f"returned {np.size(self.obs)} numbers as an observation, its space has "
                f"{int(np.prod(space.shape))}"
            )

    def _failed(self, what: str) -> RowFailedError:
        return RowFailedError(self._row, what)


class GenericVec(SyncVectorEnv):
    """n environments, one after the other; see `workers.envs.make_vec`."""

    def __init__(
        self, envs: Sequence[Env], autoreset_mode: AutoresetMode, infos: bool, remember: bool
    ) -> None:
        """`remember` what leads to where a row is, for snapshots."""
        self._rows = [_Watched(env, row, infos, remember) for row, env in enumerate(envs)]
        super().__init__([row.itself for row in self._rows], autoreset_mode=autoreset_mode)
        self.spec = envs[0].spec

    def snapshot(self, rows: Sequence[int] | None = None) -> list[Arrays]:
        """How each row came to where it is.

        Raises:
            ValueError: a row was never reset with a seed, so that it cannot be replayed.
        """
        return [self._history(row) for row in (range(self.num_envs) if rows is None else rows)]

    def restore(self, snapshots: Sequence[Arrays], rows: Sequence[int] | None = None) -> None:
        """Replay rows to where `snapshot` was taken; `is_exact` tells whether they got there."""
        numbers = range(self.num_envs) if rows is None else rows
        for row, arrays in zip(numbers, snapshots, strict=True):
            watched = self._rows[row]
            actions, space = arrays["actions"], self.single_action_space
            moves = [action.astype(space.dtype).reshape(space.shape) for action in actions]
            watched.replay(int(arrays["seed"][0]), moves, [int(n) for n in arrays["resets"]])
            reached: Any = gymnasium.spaces.flatten(self.single_observation_space, watched.obs)
            watched.exact = bool(arrays["exact"][0]) and np.array_equal(reached, arrays["obs"])
            self._env_obs[row] = watched.obs
            self._autoreset_envs[row] = bool(arrays["ended"][0])

    def reseed(self, row: int, seed: int) -> None:
        """Give a row another generator, without a reset: same state, other noise and resets.

        Snapshots do not remember it: only for rows that are not moved.
        """
        self._rows[row].unwrapped.np_random, _ = seeding.np_random(seed)

    def is_exact(self, row: int) -> bool:
        """No move has changed what comes next in this row."""
        return self._rows[row].exact

    def _history(self, row: int) -> Arrays:
        watched = self._rows[row]
        if watched.seed is None:
            raise ValueError(f"environment {row} was never reset with a seed; reset(seed=...) it")
        obs = gymnasium.spaces.flatten(self.single_observation_space, watched.obs)
        return {
            "seed": np.array([watched.seed], np.int64),
            "actions": np.array(watched.actions),
            "resets": np.array(watched.resets, np.int64),
            "obs": np.asarray(obs),
            "exact": np.array([watched.exact], np.uint8),
            "ended": np.array([self._autoreset_envs[row]], np.uint8),
        }
