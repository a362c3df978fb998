"""The MuJoCo tasks of Gymnasium, n environments at a time: observations, rewards and ends.

A kind states what one Gymnasium class states, with arrays of n rows in place of one environment's
numbers, in the same order of operations, so that every bit is the same. Weights are read from an
instance of the Gymnasium class, so keyword arguments and defaults are Gymnasium's own.
"""

from typing import Any

from workers.kinds import arms, humanoid, planar, spatial
from workers.kinds.kind import Kind

_KINDS: dict[str, type[Kind]] = {
    "ant_v4": spatial.AntV4,
    "ant_v5": spatial.AntV5,
    "half_cheetah_v4": planar.HalfCheetahV4,
    "half_cheetah_v5": planar.HalfCheetahV5,
    "hopper_v4": planar.HopperV4,
    "hopper_v5": planar.HopperV5,
    "humanoid_v4": humanoid.HumanoidV4,
    "humanoid_v5": humanoid.HumanoidV5,
    "humanoidstandup_v4": humanoid.HumanoidStandupV4,
    "humanoidstandup_v5": humanoid.HumanoidStandupV5,
    "inverted_double_pendulum_v4": arms.InvertedDoublePendulumV4,
    "inverted_double_pendulum_v5": arms.InvertedDoublePendulumV5,
    "inverted_pendulum_v4": arms.InvertedPendulumV4,
    "inverted_pendulum_v5": arms.InvertedPendulumV5,
    "pusher_v5": arms.PusherV5,
    "reacher_v4": arms.ReacherV4,
    "reacher_v5": arms.ReacherV5,
    "swimmer_v4": spatial.SwimmerV4,
    "swimmer_v5": spatial.SwimmerV5,
    "walker2d_v4": planar.Walker2dV4,
    "walker2d_v5": planar.Walker2dV5,
}
_PACKAGE = "gymnasium.envs.mujoco."


def kind_of(env: Any) -> Kind | None:  # noqa: ANN401  any unwrapped environment
    """The kind of an unwrapped environment; None if it is none of Gymnasium's own classes."""
    module = type(env).__module__
    kind = _KINDS.get(module.removeprefix(_PACKAGE)) if module.startswith(_PACKAGE) else None
    return None if kind is None else kind(env)
