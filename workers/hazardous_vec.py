"""Batched MuJoCo environments with a hazard: `workers.hazards.Hazardous`, n rows at once.

A row's draws come from its own generator, which snapshots hold, so there is nothing more to keep.
"""

from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from workers.hazards import Hazard, measured
from workers.kinds.kind import Judgement, Kind
from workers.mujoco_vec import Flags, MujocoVec


class HazardousVec(MujocoVec):
    """`MujocoVec` with noise before each step and a gamble after it."""

    def __init__(
        self,
        template: gymnasium.Env[Any, Any],
        kind: Kind,
        num_envs: int,
        autoreset_mode: AutoresetMode,
        infos: bool,
        hazard: Hazard,
    ) -> None:
        super().__init__(template, kind, num_envs, autoreset_mode, infos)
        self._hazard = hazard

    def _advance(self, actions: NDArray[Any], active: Flags | None) -> tuple[Judgement, Flags]:
        moving = np.ones(self.num_envs, np.bool_) if active is None else active
        if self._hazard.noise_std > 0:
            actions = self._disturbed(actions, moving)
        judged, truncated = super()._advance(actions, active)
        if self._hazard.risk > 0:
            judged = self._gambled(judged, moving)
        return judged, truncated

    def _disturbed(self, actions: NDArray[Any], moving: Flags) -> NDArray[Any]:
        space = self.single_action_space
        assert isinstance(space, gymnasium.spaces.Box)
        noise = np.zeros(actions.shape)
        for row in map(int, np.flatnonzero(moving)):
            self._generator(row).standard_normal(out=noise[row])
        return self._hazard.disturbed(actions, noise, space)

    def _gambled(self, judged: Judgement, moving: Flags) -> Judgement:
        beyond = measured(self._hazard, self._now, judged.info) > self._hazard.threshold
        gamble = np.zeros(self.num_envs)
        for row in map(int, np.flatnonzero(beyond & moving)):
            gamble[row] = self._hazard.gamble(self._generator(row))
        reward = judged.reward.astype(np.float64, copy=False) + gamble
        return Judgement(reward, judged.terminated, lambda: judged.info() | {"gamble": gamble})
