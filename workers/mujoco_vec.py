"""Gymnasium's MuJoCo environments, n at a time in one process, bit by bit the same.

Physics runs one environment after the other (`workers.simulations`); observations, rewards and
ends of all of them are computed at once (`workers.kinds`). A reset is Gymnasium's own code, on an
MjData of its own.

Shape letters: n environments · O observation size · A action size.
"""

from collections.abc import Sequence
from typing import Any

import gymnasium
import mujoco
import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from workers.kinds.kind import Float64, Judgement, Kind
from workers.physics import tuned
from workers.simulations import simulations, state_of
from workers.snapshots import Arrays, generator_from, generator_state

Flags = NDArray[np.bool_]


class MujocoVec(VectorEnv[Any, Any, Any]):
    """n environments of one kind; see `workers.envs.make_vec`."""

    def __init__(
        self,
        template: gymnasium.Env[Any, Any],
        kind: Kind,
        num_envs: int,
        autoreset_mode: AutoresetMode,
        infos: bool,
    ) -> None:
        """`template` makes the resets; its model is replaced by one that steps sooner."""
        self.num_envs, self.spec, self._template = num_envs, template.spec, template
        self.metadata = {**template.metadata, "autoreset_mode": autoreset_mode}
        self.single_observation_space = template.observation_space
        self.single_action_space = template.action_space
        self.observation_space = batch_space(template.observation_space, num_envs)
        self.action_space = batch_space(template.action_space, num_envs)
        self._kind, self._env, self._infos = kind, kind.env, infos
        self._mode = autoreset_mode
        self._limit = getattr(template.spec, "max_episode_steps", None) or np.inf
        self._model = self._env.model = tuned(self._env.fullpath, self._env.model)
        self._env.data = mujoco.MjData(self._model)  # resets are made in it
        self._fields = kind.fields()
        self._simulations = simulations(
            self._model, num_envs, self._env.frame_skip, self._fields, kind.forces
        )
        self._rngs: list[np.random.Generator | None] = [None] * num_envs
        self._elapsed = np.zeros(num_envs, np.int64)
        self._begun = np.zeros(num_envs, np.bool_)
        self._ended = np.zeros(num_envs, np.bool_)
        shapes = {name: field.of(self._env.data).shape for name, field in self._fields.items()}
        self._now = {name: np.zeros((num_envs, *shape)) for name, shape in shapes.items()}
        self._before = {name: array.copy() for name, array in self._now.items()}

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Float64, dict[str, Any]]:
        """Begin new episodes, in the rows of `options["reset_mask"]` [n] if it is given.

        Args:
            seed: one per row, or the first one's; None goes on with a row's own generator.
            options: `reset_mask` only; Gymnasium's MuJoCo environments have no others.
        """
        seeds = seeds_of(seed, self.num_envs)
        mask = (options or {}).get("reset_mask", np.ones(self.num_envs, np.bool_))
        infos: dict[str, Any] = {}
        for row in _numbers(mask):
            info = self._begin(row, seeds[row])
            if self._infos:
                infos = self._add_info(infos, info, row)
        return self._kind.observe(self._now), infos

    def step(self, actions: NDArray[Any]) -> tuple[Float64, Float64, Flags, Flags, dict[str, Any]]:
        """One step of every row with actions [n, A], which MuJoCo clips at its control range.

        Rows whose episode has ended begin anew as `autoreset_mode` says.
        """
        actions = self._checked(actions)
        resting = self._ended if self._mode is AutoresetMode.NEXT_STEP else None
        if resting is not None and np.count_nonzero(resting):
            return self._step_some(actions, ~resting)
        judged, truncated = self._advance(actions, None)
        obs, infos = self._kind.observe(self._now), self._info(judged, None)
        self._ended = judged.terminated | truncated
        if self._mode is AutoresetMode.SAME_STEP and np.count_nonzero(self._ended):
            infos = self._end(obs, judged)
            obs = self._kind.observe(self._now)
        reward = judged.reward.astype(np.float64, copy=False)
        return obs, reward, judged.terminated, truncated, infos

    def _checked(self, actions: NDArray[Any]) -> NDArray[Any]:
        """The actions, row by row in memory: sums over a row depend on that.

        Raises:
            ValueError: another shape than the action space's.
            ResetNeeded: a row has no episode under way.
        """
        if np.shape(actions) != self.action_space.shape:
            raise ValueError(
                f"actions have shape {np.shape(actions)}, expected {self.action_space.shape}"
            )
        is_unbegun = np.count_nonzero(self._begun) < self.num_envs
        is_manual = self._mode is AutoresetMode.DISABLED
        if is_unbegun or (is_manual and np.count_nonzero(self._ended)):
            rows = np.flatnonzero(~self._begun | self._ended).tolist()
            raise gymnasium.error.ResetNeeded(
                f"rows {rows} have no episode under way; call reset, with reset_mask for some rows"
            )
        return np.ascontiguousarray(actions)

    def snapshot(self, rows: Sequence[int] | None = None) -> list[Arrays]:
        """Everything that the future of each row depends on, besides its actions."""
        snapshots = []
        for row in range(self.num_envs) if rows is None else rows:
            arrays: Arrays = {
                "mujoco": self._simulations.state(row),
                "counts": np.array(
                    [self._elapsed[row], self._begun[row], self._ended[row]], np.int64
                ),
                "generator": generator_state(self._generator(row)),
            }
            # what the last step left behind, such as positions before it: rewards read it
            arrays |= {name: array[row].copy() for name, array in self._now.items()}
            snapshots.append(arrays)
        return snapshots

    def restore(self, snapshots: Sequence[Arrays], rows: Sequence[int] | None = None) -> None:
        """Put rows where `snapshot` was taken, here or elsewhere."""
        numbers = range(self.num_envs) if rows is None else rows
        for row, arrays in zip(numbers, snapshots, strict=True):
            self._simulations.put(row, arrays["mujoco"])
            self._rngs[row] = generator_from(arrays["generator"])
            self._elapsed[row], self._begun[row], self._ended[row] = arrays["counts"]
            for name, array in self._now.items():
                array[row] = arrays[name].reshape(array.shape[1:])

    def reseed(self, row: int, seed: int) -> None:
        """Give a row another generator, without a reset: same state, other noise and resets."""
        self._rngs[row], _ = seeding.np_random(seed)

    def is_exact(self, row: int) -> bool:
        """No move has changed what comes next in this row."""
        del row
        return True

    def close_extras(self, **kwargs: Any) -> None:  # noqa: ANN401  the signature of VectorEnv
        """Close the template."""
        del kwargs
        self._template.close()

    def _advance(self, actions: NDArray[Any], active: Flags | None) -> tuple[Judgement, Flags]:
        """Physics of the active rows (None: all), then what the step was worth."""
        self._before, self._now = self._now, self._before
        self._simulations.step(actions, active)
        self._simulations.read(self._now)
        self._elapsed += 1 if active is None else active
        return self._kind.judge(self._before, self._now, actions), self._elapsed >= self._limit

    def _begin(self, row: int, seed: int | None) -> dict[str, Any]:
        """Gymnasium's reset of one row; its info."""
        env, data = self._env, self._env.data
        if seed is not None:
            self._rngs[row], _ = seeding.np_random(seed)
        env.np_random = self._generator(row)
        mujoco.mj_resetData(self._model, data)
        env.reset_model()
        self._simulations.put(row, state_of(self._model, data))
        self._elapsed[row], self._begun[row], self._ended[row] = 0, True, False
        for name, field in self._fields.items():
            self._now[name][row] = field.of(data)
        info: dict[str, Any] = env._get_reset_info()
        return info

    def _generator(self, row: int) -> np.random.Generator:
        rng = self._rngs[row]
        if rng is None:
            rng, _ = seeding.np_random()
            self._rngs[row] = rng
        return rng

    def _step_some(
        self, actions: NDArray[Any], active: Flags
    ) -> tuple[Float64, Float64, Flags, Flags, dict[str, Any]]:
        """NEXT_STEP: the rows that have ended begin anew instead of stepping, with reward 0."""
        judged, truncated = self._advance(actions, active)
        infos = self._info(judged, active)
        for row in _numbers(~active):
            info = self._begin(row, None)
            if self._infos:
                infos = self._add_info(infos, info, row)
        terminated, truncated = judged.terminated & active, truncated & active
        self._ended = terminated | truncated
        obs = self._kind.observe(self._now)
        return obs, np.where(active, judged.reward, 0.0), terminated, truncated, infos

    def _end(self, obs: Float64, judged: Judgement) -> dict[str, Any]:
        """SAME_STEP: rows that have ended begin anew; the infos, with the final ones."""
        ended, rows, info = self._ended, _numbers(self._ended), judged.info()
        finals = [{name: values[row].copy() for name, values in info.items()} for row in rows]
        infos = self._info(judged, ~ended)
        for row, final in zip(rows, finals, strict=True):
            facts = {"final_obs": obs[row].copy(), "final_info": final, **self._begin(row, None)}
            infos = self._add_info(infos, facts, row)
        return infos

    def _info(self, judged: Judgement, active: Flags | None) -> dict[str, Any]:
        """Arrays and their masks, as VectorEnv gives them."""
        if not self._infos or (active is not None and not active.any()):
            return {}
        mask = np.ones(self.num_envs, np.bool_) if active is None else active
        infos: dict[str, Any] = {}
        for name, values in judged.info().items():
            infos |= {name: values.copy(), f"_{name}": mask.copy()}
            if active is not None:
                infos[name][~active] = 0
        return infos


def _numbers(mask: Flags) -> list[int]:
    """The rows of a mask."""
    return [int(row) for row in np.flatnonzero(mask)]


def seeds_of(seed: int | Sequence[int | None] | None, num_envs: int) -> list[int | None]:
    """One seed per row, as Gymnasium spreads them.

    Raises:
        ValueError: a list of another length.
    """
    if seed is None or isinstance(seed, int):
        return [None if seed is None else seed + row for row in range(num_envs)]
    if len(seed) != num_envs:
        raise ValueError(f"{len(seed)} seeds for {num_envs} environments; give one for each")
    return list(seed)
