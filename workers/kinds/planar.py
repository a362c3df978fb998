"""HalfCheetah, Hopper and Walker2d: run forward in a plane."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from workers.kinds.kind import Array, Float64, Judgement, Kind, State, clipped, never, square_sum


class _Runner(Kind):
    """Forward reward, healthy reward and control cost of -v4 and -v5."""

    def __init__(self, env: Any) -> None:  # noqa: ANN401  as in Kind
        super().__init__(env)
        self._first = 1 if env._exclude_current_positions_from_observation else 0

    def observe(self, now: State) -> Float64:
        return np.concatenate((now["qpos"][:, self._first :], self._velocity(now)), axis=1)

    def _velocity(self, now: State) -> Float64:
        return clipped(now["qvel"], -10, 10)

    def _motion(self, before: State, now: State, action: Array) -> tuple[Float64, Float64, Array]:
        """x, its velocity, and the control cost."""
        x = now["qpos"][:, 0]
        velocity = (x - before["qpos"][:, 0]) / self.dt
        return x, velocity, self.env._ctrl_cost_weight * square_sum(action)


class HalfCheetahV4(_Runner):
    """Never ends."""

    def _velocity(self, now: State) -> Float64:
        return now["qvel"]

    def judge(self, before: State, now: State, action: Array) -> Judgement:
        x, velocity, cost = self._motion(before, now, action)
        forward = self.env._forward_reward_weight * velocity

        def info() -> dict[str, Array]:
            parts = self._parts(forward, cost)
            return {"x_position": x.copy(), "x_velocity": velocity, **parts}

        return Judgement(forward - cost, never(action), info)

    def _parts(self, forward: Float64, cost: Array) -> dict[str, Array]:
        return {"reward_run": forward, "reward_ctrl": -cost}


class HalfCheetahV5(HalfCheetahV4):
    """Other names in `info`."""

    def _parts(self, forward: Float64, cost: Array) -> dict[str, Array]:
        return {"reward_forward": forward, "reward_ctrl": -cost}


class Walker2dV4(_Runner):
    """Ends when it falls."""

    def __init__(self, env: Any) -> None:  # noqa: ANN401  as in Kind
        super().__init__(env)
        self._healthy_range = self._bounds()

    def judge(self, before: State, now: State, action: Array) -> Judgement:
        env = self.env
        x, velocity, cost = self._motion(before, now, action)
        healthy = self._healthy(now)
        forward = env._forward_reward_weight * velocity
        alive = self._alive(healthy)

        def info() -> dict[str, Array]:
            parts = self._parts(now, forward, cost, alive)
            return {"x_position": x.copy(), "x_velocity": velocity, **parts}

        return Judgement(forward + alive - cost, ~healthy & env._terminate_when_unhealthy, info)

    def _bounds(self) -> tuple[Float64, Float64]:
        """Between what z, the torso's angle and what `_posture` adds have to stay."""
        z, angle = self.env._healthy_z_range, self.env._healthy_angle_range
        low, high = zip(z, angle, strict=True)
        return np.array(low, np.float64), np.array(high, np.float64)

    def _posture(self, now: State) -> Float64:
        return now["qpos"][:, 1:3]

    def _healthy(self, now: State) -> NDArray[np.bool_]:
        (low, high), posture = self._healthy_range, self._posture(now)
        healthy: NDArray[np.bool_] = np.all((low < posture) & (posture < high), axis=1)
        return healthy

    def _alive(self, healthy: NDArray[np.bool_]) -> Float64:
        if self.env._terminate_when_unhealthy:
            return np.full(len(healthy), 1.0 * self.env._healthy_reward)
        alive: Float64 = healthy * np.float64(self.env._healthy_reward)
        return alive

    def _parts(
        self, now: State, forward: Float64, cost: Array, alive: Float64
    ) -> dict[str, Array]:
        del now, forward, cost, alive
        return {}


class Walker2dV5(Walker2dV4):
    """The fallen get no healthy reward; `info` tells more."""

    def _alive(self, healthy: NDArray[np.bool_]) -> Float64:
        alive: Float64 = healthy * np.float64(self.env._healthy_reward)
        return alive

    def _parts(
        self, now: State, forward: Float64, cost: Array, alive: Float64
    ) -> dict[str, Array]:
        return {
            "z_distance_from_origin": now["qpos"][:, 1] - self.env.init_qpos[1],
            "reward_forward": forward,
            "reward_ctrl": -cost,
            "reward_survive": alive,
        }


class HopperV4(Walker2dV4):
    """The whole state from the angle on has to stay in a range."""

    def _bounds(self) -> tuple[Float64, Float64]:
        (low, high), (least, most) = super()._bounds(), self.env._healthy_state_range
        others = self.env.model.nq + self.env.model.nv - 3
        return (
            np.array([low[0], max(low[1], least), *[least] * others]),
            np.array([high[0], min(high[1], most), *[most] * others]),
        )

    def _posture(self, now: State) -> Float64:
        return np.concatenate((now["qpos"], now["qvel"]), axis=1)[:, 1:]


class HopperV5(HopperV4, Walker2dV5):
    """As Walker2dV5, with the Hopper's idea of health."""
