"""Ant and Swimmer: run forward in space."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from workers.kinds.kind import (
    Array,
    Field,
    Float64,
    Judgement,
    Kind,
    State,
    are_finite,
    body,
    clipped,
    motion,
    never,
    square_sum,
)


class AntV4(Kind):
    """Contact forces only if asked for."""

    def __init__(self, env: Any) -> None:  # noqa: ANN401  as in Kind
        super().__init__(env)
        self._first = 2 if env._exclude_current_positions_from_observation else 0
        self.forces = self._reads_forces()

    def _reads_forces(self) -> bool:
        return bool(self.env._use_contact_forces)

    def fields(self) -> dict[str, Field]:
        fields = super().fields() | {"torso": body(self.env, "torso")}
        if self.forces:
            fields["cfrc_ext"] = Field("cfrc_ext")
        return fields

    def observe(self, now: State) -> Float64:
        parts = [now["qpos"][:, self._first :], now["qvel"]]
        if self.forces:
            parts.append(self._contact_forces(now).reshape(len(parts[0]), -1))
        return np.concatenate(parts, axis=1)

    def judge(self, before: State, now: State, action: Array) -> Judgement:
        env, xy = self.env, now["torso"][:, :2].copy()
        velocity = (xy - before["torso"][:, :2]) / self.dt
        healthy = self._healthy(now)
        forward = velocity[:, 0]
        alive = np.full(len(action), 1.0 * env._healthy_reward)
        if not env._terminate_when_unhealthy:
            alive = healthy * float(env._healthy_reward)
        cost = told = env._ctrl_cost_weight * square_sum(action)
        if self.forces:
            told = env._contact_cost_weight * square_sum(self._contact_forces(now))
            cost = cost + told  # but `info` has one of them, as Gymnasium's

        def info() -> dict[str, Array]:
            return {
                "reward_forward": forward,
                "reward_ctrl": -told,
                "reward_survive": alive,
                **motion(xy, velocity),
                "forward_reward": forward,
            }

        terminated = ~healthy & env._terminate_when_unhealthy
        return Judgement(forward + alive - cost, terminated, info)

    def _healthy(self, now: State) -> NDArray[np.bool_]:
        low, high = self.env._healthy_z_range
        z = now["qpos"][:, 2]
        healthy: NDArray[np.bool_] = (low <= z) & (z <= high)
        for values in (now["qpos"], now["qvel"]):
            if not are_finite(values):
                healthy &= np.isfinite(values).all(axis=1)
        return healthy

    def _contact_forces(self, now: State) -> Float64:
        low, high = self.env._contact_force_range
        return clipped(now["cfrc_ext"], low, high)


class AntV5(AntV4):
    """Contact forces in the reward, and without the world's in the observation."""

    def _reads_forces(self) -> bool:
        return True

    def fields(self) -> dict[str, Field]:
        return super().fields() | {"torso": body(self.env, self.env._main_body)}

    def observe(self, now: State) -> Float64:
        parts = [now["qpos"][:, self._first :], now["qvel"]]
        if self.env._include_cfrc_ext_in_observation:
            parts.append(self._contact_forces(now)[:, 1:].reshape(len(parts[0]), -1))
        return np.concatenate(parts, axis=1)

    def judge(self, before: State, now: State, action: Array) -> Judgement:
        env, xy = self.env, now["qpos"][:, :2].copy()
        velocity = (now["torso"][:, :2] - before["torso"][:, :2]) / self.dt
        healthy = self._healthy(now)
        forward = velocity[:, 0] * env._forward_reward_weight
        alive = healthy * float(env._healthy_reward)
        ctrl_cost = env._ctrl_cost_weight * square_sum(action)
        contact_cost = env._contact_cost_weight * square_sum(self._contact_forces(now))

        def info() -> dict[str, Array]:
            return {
                **motion(xy, velocity),
                "reward_forward": forward,
                "reward_ctrl": -ctrl_cost,
                "reward_contact": -contact_cost,
                "reward_survive": alive,
            }

        reward = forward + alive - (ctrl_cost + contact_cost)
        return Judgement(reward, ~healthy & env._terminate_when_unhealthy, info)


class SwimmerV4(Kind):
    """Never ends."""

    def __init__(self, env: Any) -> None:  # noqa: ANN401  as in Kind
        super().__init__(env)
        self._first = 2 if env._exclude_current_positions_from_observation else 0

    def observe(self, now: State) -> Float64:
        return np.concatenate((now["qpos"][:, self._first :], now["qvel"]), axis=1)

    def judge(self, before: State, now: State, action: Array) -> Judgement:
        xy = now["qpos"][:, :2].copy()
        velocity = (xy - before["qpos"][:, :2]) / self.dt
        forward = self.env._forward_reward_weight * velocity[:, 0]
        cost = self.env._ctrl_cost_weight * square_sum(action)

        def info() -> dict[str, Array]:
            return {
                **motion(xy, velocity),
                **self._parts(forward, cost),
            }

        return Judgement(forward - cost, never(action), info)

    def _parts(self, forward: Float64, cost: Array) -> dict[str, Array]:
        return {"reward_fwd": forward, "reward_ctrl": -cost, "forward_reward": forward}


class SwimmerV5(SwimmerV4):
    """Other names in `info`."""

    def _parts(self, forward: Float64, cost: Array) -> dict[str, Array]:
        return {"reward_forward": forward, "reward_ctrl": -cost}
