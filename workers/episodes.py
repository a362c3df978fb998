"""The environments of some slots, row by row: their episodes one after the other, their moves.

Shape letters: n rows (environments of all the slots together) · O observation size · A action
size.
"""

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dppo.config import Config
from dppo.streams import reset_seed
from workers.envs import Adapter, Vec, name_of, training_vec
from workers.failures import EnvironmentFailedError, RowFailedError, odd_row
from workers.heart import beat
from workers.snapshots import Arrays

log = logging.getLogger("worker")
Float64 = NDArray[np.float64]
Flags = NDArray[np.bool_]


class Row(NamedTuple):
    """Which environment of which slot a row is."""

    slot: int
    env: int


@dataclass(frozen=True, slots=True)
class Step:
    """What one step gave, [n, ...]."""

    next_obs: Float64  # [n, O]  the final observation where an episode ended
    reward: Float64
    terminated: Flags
    truncated: Flags


class Episodes:
    """n environments, each reset with its own seed for every episode."""

    def __init__(self, config: Config, rows: Sequence[Row]) -> None:
        exact = config.rollout.exact_envs
        self.vec: Vec = training_vec(config.run, len(rows), remember=exact)
        self.adapter = Adapter(self.vec.single_observation_space, self.vec.single_action_space)
        self._rows, self._exact = tuple(rows), exact
        self._seed = config.run.seed
        self.gamma = config.returns.gamma
        """Of the present iteration."""
        self._moved = np.zeros(len(rows), np.bool_)
        self.obs: Float64 = np.zeros((len(rows), self.adapter.obs_size))
        """[n, O] s_t, raw."""
        self.episode = np.full(len(rows), -1, np.int64)
        self.steps = np.zeros(len(rows), np.int64)
        """Steps of the present episodes so far."""
        self.score = np.zeros(len(rows))
        """Undiscounted returns of the present episodes so far."""
        self.discounted = np.zeros(len(rows))
        """Discounted sums of past rewards of these episodes: what rewards are scaled by."""

    def begin(self, rows: Flags | None = None) -> None:
        """Start the next episode in these rows, or in all."""
        beat()
        mask = np.ones(len(self._rows), np.bool_) if rows is None else rows
        self.episode[mask] += 1
        for array in (self.steps, self.score, self.discounted):
            array[mask] = 0
        seeds = [self._reset_seed(n) if mask[n] else None for n in range(len(mask))]
        try:
            found, _ = self.vec.reset(seed=seeds, options={"reset_mask": mask.copy()})
        except RowFailedError as error:
            raise self._failed(error.row, error.what) from error
        self.obs = np.where(mask[:, None], self._flat(found), self.obs)
        self._check(self.obs, np.zeros(len(mask)))

    def step(self, action: NDArray[np.float32]) -> Step:
        """One step with [n, A]; the caller begins the next episodes after ends."""
        beat()
        try:
            found, reward, terminated, truncated, _ = self.vec.step(self.adapter.to_envs(action))
        except RowFailedError as error:
            raise self._failed(error.row, error.what) from error
        self.obs = self._flat(found)
        self._check(self.obs, reward)
        self.steps += 1
        self.score += reward
        self.discounted = self.gamma * self.discounted + reward
        return Step(self.obs, reward, terminated, truncated)

    def is_exact(self, row: int) -> bool:
        """No move has changed what comes next in this row."""
        return not self._moved[row] and self.vec.is_exact(row)

    def capture(self, row: int) -> Arrays:
        """Where a row is, as arrays."""
        arrays: Arrays = {
            "obs": self.obs[row],
            "counts": np.array([self.episode[row], self.steps[row], self._moved[row]], np.int64),
            "sums": np.array([self.score[row], self.discounted[row]]),
        }
        if self._exact:
            (state,) = self.vec.snapshot([row])
            arrays |= {f"env.{name}": array for name, array in state.items()}
        return arrays

    def restore(self, states: Sequence[Arrays]) -> None:
        """All rows to where they were captured; without exact environments, to new episodes."""
        for row, arrays in enumerate(states):
            self.episode[row], self.steps[row], self._moved[row] = arrays["counts"]
            self.score[row], self.discounted[row] = arrays["sums"]
        if not self._exact:
            self._moved[:] = True
            self.begin()
            return
        try:
            self.vec.restore(
                [
                    {name[4:]: array for name, array in arrays.items() if name.startswith("env.")}
                    for arrays in states
                ]
            )
        except RowFailedError as error:
            raise self._failed(error.row, error.what) from error
        self.obs = np.stack([arrays["obs"] for arrays in states]).astype(np.float64)
        for (slot, env), arrays, exact in zip(
            self._rows, states, map(self.vec.is_exact, range(len(states))), strict=True
        ):
            if not exact:
                log.warning(
                    "slot %d, environment %d: replaying %d actions ended in another observation; "
                    "the environment is not deterministic, so this run is no longer exact",
                    slot,
                    env,
                    len(arrays["env.actions"]),
                )

    def close(self) -> None:
        """Close the environments."""
        self.vec.close()

    def _flat(self, found: NDArray[np.number]) -> Float64:
        return np.asarray(found, np.float64).reshape(len(self._rows), -1)

    def _check(self, obs: Float64, reward: Float64) -> None:
        row = odd_row(obs, reward)
        if row is None:
            return
        what = "reward" if not np.isfinite(reward[row]) else f"observation {obs[row].tolist()}"
        raise self._failed(row, f"returned a {what} that is not finite (reward {reward[row]})")

    def _reset_seed(self, row: int) -> int:
        slot, env = self._rows[row]
        return reset_seed(self._seed, slot, env, int(self.episode[row]))

    def _failed(self, row: int, what: str) -> EnvironmentFailedError:
        slot, env = self._rows[row]
        name = name_of(self.vec)
        return EnvironmentFailedError(
            slot,
            f"slot {slot}, environment {env} ({name}) {what} at step {self.steps[row]} of "
            f"episode {self.episode[row]} (reset seed {self._reset_seed(row)})",
        )
