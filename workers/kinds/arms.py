"""Pendulums, Reacher and Pusher."""

import numpy as np

from workers.kinds.kind import (
    Array,
    Field,
    Float64,
    Judgement,
    Kind,
    State,
    body,
    clipped,
    never,
    norm,
    square_sum,
)


class InvertedPendulumV4(Kind):
    """A reward of 1 for every step, the last one too."""

    def observe(self, now: State) -> Float64:
        return np.concatenate((now["qpos"], now["qvel"]), axis=1)

    def judge(self, before: State, now: State, action: Array) -> Judgement:
        del before, action
        obs = self.observe(now)
        terminated = ~np.isfinite(obs).all(axis=1) | (np.abs(obs[:, 1]) > 0.2)
        return self._judged(terminated)

    def _judged(self, terminated: Array) -> Judgement:
        return Judgement(np.ones(len(terminated)), terminated)


class InvertedPendulumV5(InvertedPendulumV4):
    """No reward for the last step."""

    def _judged(self, terminated: Array) -> Judgement:
        reward = (~terminated).astype(int)
        return Judgement(reward, terminated, lambda: {"reward_survive": reward})


class InvertedDoublePendulumV4(Kind):
    """Stay upright and slow."""

    def fields(self) -> dict[str, Field]:
        return super().fields() | {
            "tip": Field("site_xpos", 0),
            "qfrc_constraint": Field("qfrc_constraint"),
        }

    def observe(self, now: State) -> Float64:
        cart, angles = now["qpos"][:, :1], now["qpos"][:, 1:]
        force = clipped(now["qfrc_constraint"], -10, 10)[:, : self._forces()]
        speed = clipped(now["qvel"], -10, 10)
        return np.concatenate((cart, np.sin(angles), np.cos(angles), speed, force), axis=1)

    def _forces(self) -> int | None:
        return None

    def judge(self, before: State, now: State, action: Array) -> Judgement:
        del before, action
        rows = zip(now["tip"], now["qvel"], strict=True)
        # number by number: a power of one number and of an array may differ in the last bit
        penalties = [
            (0.01 * tip[0] ** 2 + (tip[2] - 2) ** 2, 0.001 * v[1] ** 2 + 0.005 * v[2] ** 2)
            for tip, v in rows
        ]
        distance, velocity = np.array(penalties).T
        terminated = now["tip"][:, 2] <= 1
        return self._judged(distance, velocity, terminated)

    def _judged(self, distance: Float64, velocity: Float64, terminated: Array) -> Judgement:
        return Judgement(10 - distance - velocity, terminated)


class InvertedDoublePendulumV5(InvertedDoublePendulumV4):
    """No healthy reward for the last step; one constraint force."""

    def _forces(self) -> int | None:
        return 1

    def _judged(self, distance: Float64, velocity: Float64, terminated: Array) -> Judgement:
        alive = self.env._healthy_reward * (~terminated).astype(int)

        def info() -> dict[str, Array]:
            return {
                "reward_survive": alive,
                "distance_penalty": -distance,
                "velocity_penalty": -velocity,
            }

        return Judgement(alive - distance - velocity, terminated, info)


class ReacherV4(Kind):
    """The reward is for where the step began."""

    def fields(self) -> dict[str, Field]:
        return super().fields() | {
            "fingertip": body(self.env, "fingertip"),
            "target": body(self.env, "target"),
        }

    def observe(self, now: State) -> Float64:
        theta = now["qpos"][:, :2]
        reach = (now["fingertip"] - now["target"])[:, : self._axes()]
        parts = (np.cos(theta), np.sin(theta), now["qpos"][:, 2:], now["qvel"][:, :2], reach)
        return np.concatenate(parts, axis=1)

    def _axes(self) -> int:
        return 3

    def judge(self, before: State, now: State, action: Array) -> Judgement:
        del now
        return self._judged(before, action, 1, 1)

    def _judged(self, at: State, action: Array, near: float, control: float) -> Judgement:
        distance = -norm(at["fingertip"] - at["target"]) * near
        effort = -square_sum(action) * control
        parts = {"reward_dist": distance, "reward_ctrl": effort}
        return Judgement(distance + effort, never(action), lambda: parts)


class ReacherV5(ReacherV4):
    """The reward is for where the step ended."""

    def _axes(self) -> int:
        return 2

    def judge(self, before: State, now: State, action: Array) -> Judgement:
        del before
        env = self.env
        return self._judged(now, action, env._reward_dist_weight, env._reward_control_weight)


class PusherV5(Kind):
    """Push the object to the goal. There is no -v4 for MuJoCo 3 and later."""

    def fields(self) -> dict[str, Field]:
        bodies = ("tips_arm", "object", "goal")
        return super().fields() | {name: body(self.env, name) for name in bodies}

    def observe(self, now: State) -> Float64:
        parts = (now["qpos"][:, :7], now["qvel"][:, :7])
        return np.concatenate((*parts, now["tips_arm"], now["object"], now["goal"]), axis=1)

    def judge(self, before: State, now: State, action: Array) -> Judgement:
        del before
        near = -norm(now["object"] - now["tips_arm"]) * self.env._reward_near_weight
        distance = -norm(now["object"] - now["goal"]) * self.env._reward_dist_weight
        effort = -square_sum(action) * self.env._reward_control_weight
        parts = {"reward_dist": distance, "reward_ctrl": effort, "reward_near": near}
        return Judgement(distance + effort + near, never(action), lambda: parts)
