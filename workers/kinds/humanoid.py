"""Humanoid and HumanoidStandup."""

from dataclasses import replace
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
    motion,
    never,
    square_sum,
)

_PARTS = ("cinert", "cvel", "qfrc_actuator", "cfrc_ext")


class _Body(Kind):
    """Observations of both: state, inertias, velocities, actuator and contact forces."""

    forces = True

    def fields(self) -> dict[str, Field]:
        return super().fields() | {
            "cinert": Field("cinert"),
            "cvel": Field("cvel"),
            "qfrc_actuator": Field("qfrc_actuator"),
            "cfrc_ext": Field("cfrc_ext"),
            "ctrl": Field("ctrl"),
        }

    def observe(self, now: State) -> Float64:
        """-v4: everything, the world's rows included."""
        rows = len(now["qpos"])
        parts = [now["qpos"][:, self._first() :], now["qvel"]]
        parts += [now[name].reshape(rows, -1) for name in _PARTS]
        return np.concatenate(parts, axis=1)

    def _first(self) -> int:
        return 2 if getattr(self.env, "_exclude_current_positions_from_observation", True) else 0


class _BodyV5(_Body):
    """Without the world's rows; parts can be left out."""

    def fields(self) -> dict[str, Field]:
        return super().fields() | {
            "tendon_length": Field("ten_length"),
            "tendon_velocity": Field("ten_velocity"),
        }

    def observe(self, now: State) -> Float64:
        rows = len(now["qpos"])
        parts = [now["qpos"][:, self._first() :], now["qvel"]]
        for name in _PARTS:
            if getattr(self.env, f"_include_{name}_in_observation") is True:
                skipped = 6 if name == "qfrc_actuator" else 1
                parts.append(now[name][:, skipped:].reshape(rows, -1))
        return np.concatenate(parts, axis=1)

    def _tendons(self, now: State) -> dict[str, Array]:
        return {name: now[name].copy() for name in ("tendon_length", "tendon_velocity")}


class HumanoidV4(_Body):
    """Ends when it falls. The velocity is that of the centre of mass."""

    def __init__(self, env: Any) -> None:  # noqa: ANN401  as in Kind
        super().__init__(env)
        self._mass = env.model.body_mass.copy()
        self._total = env.model.body_mass.sum()

    def fields(self) -> dict[str, Field]:
        return super().fields() | {"xipos": Field("xipos")}

    def judge(self, before: State, now: State, action: Array) -> Judgement:
        env, xy = self.env, self._centre(now)
        velocity = (xy - self._centre(before)) / self.dt
        healthy = self._healthy(now)
        alive = np.full(len(action), 1.0 * env._healthy_reward)
        if not env._terminate_when_unhealthy:
            alive = healthy * float(env._healthy_reward)
        cost = env._ctrl_cost_weight * square_sum(now["ctrl"])
        forward = env._forward_reward_weight * velocity[:, 0]

        def info() -> dict[str, Array]:
            return {
                "reward_linvel": forward,
                "reward_quadctrl": -cost,
                "reward_alive": alive,
                **motion(xy, velocity),
                "forward_reward": forward,
            }

        terminated = ~healthy & env._terminate_when_unhealthy
        return Judgement(forward + alive - cost, terminated, info)

    def _centre(self, state: State) -> Float64:
        """[n, 2] centre of mass; row by row, as sums over bodies have an order."""
        rows = [np.einsum("b,bj->j", self._mass, xipos) for xipos in state["xipos"]]
        centre: Float64 = (np.array(rows) / self._total)[:, :2]
        return centre

    def _healthy(self, now: State) -> NDArray[np.bool_]:
        low, high = self.env._healthy_z_range
        z = now["qpos"][:, 2]
        healthy: NDArray[np.bool_] = (low < z) & (z < high)
        return healthy


class HumanoidV5(_BodyV5, HumanoidV4):
    """A contact cost; the fallen get no healthy reward."""

    def judge(self, before: State, now: State, action: Array) -> Judgement:
        del action
        env, xy = self.env, now["qpos"][:, :2].copy()
        velocity = (self._centre(now) - self._centre(before)) / self.dt
        healthy = self._healthy(now)
        forward = env._forward_reward_weight * velocity[:, 0]
        alive = healthy * float(env._healthy_reward)
        ctrl_cost = env._ctrl_cost_weight * square_sum(now["ctrl"])
        contact_cost = np.clip(
            env._contact_cost_weight * square_sum(now["cfrc_ext"]), *env._contact_cost_range
        )

        def info() -> dict[str, Array]:
            return {
                **motion(xy, velocity),
                **self._tendons(now),
                "reward_survive": alive,
                "reward_forward": forward,
                "reward_ctrl": -ctrl_cost,
                "reward_contact": -contact_cost,
            }

        reward = forward + alive - (ctrl_cost + contact_cost)
        return Judgement(reward, ~healthy & env._terminate_when_unhealthy, info)


class HumanoidStandupV4(_Body):
    """Get up: height over time. Never ends."""

    def judge(self, before: State, now: State, action: Array) -> Judgement:
        del before
        up = (now["qpos"][:, 2] - 0) / self.env.model.opt.timestep
        ctrl_cost, impact_cost = self._costs(now)

        def info() -> dict[str, Array]:
            return {
                "reward_linup": up,
                "reward_quadctrl": -ctrl_cost,
                "reward_impact": -impact_cost,
            }

        return Judgement(up - ctrl_cost - impact_cost + 1, never(action), info)

    def _costs(self, now: State) -> tuple[Float64, Float64]:
        impact: Float64 = 0.5e-6 * square_sum(now["cfrc_ext"])
        return 0.1 * square_sum(now["ctrl"]), np.minimum(impact, 10)


class HumanoidStandupV5(_BodyV5, HumanoidStandupV4):
    """Weights can be set; `info` tells more."""

    def judge(self, before: State, now: State, action: Array) -> Judgement:
        judged = super().judge(before, now, action)

        def info() -> dict[str, Array]:
            return {
                **judged.info(),
                "x_position": now["qpos"][:, 0].copy(),
                "y_position": now["qpos"][:, 1].copy(),
                "z_distance_from_origin": now["qpos"][:, 2] - self.env.init_qpos[2],
                **self._tendons(now),
            }

        return replace(judged, info=info)

    def _costs(self, now: State) -> tuple[Float64, Float64]:
        impact: Float64 = self.env._impact_cost_weight * square_sum(now["cfrc_ext"])
        return self.env._ctrl_cost_weight * square_sum(now["ctrl"]), np.clip(
            impact, *self.env._impact_cost_range
        )
