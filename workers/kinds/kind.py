"""What a kind of environment is.

Shape letters: n environments · O observation size · A action size.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
Float64 = NDArray[np.float64]
State = Mapping[str, Float64]
"""Fields of MjData by name, [n, ...]."""


class Field(NamedTuple):
    """A field of MjData, or one of its rows."""

    name: str
    row: int | None = None

    def of(self, data: Any) -> Float64:  # noqa: ANN401  MjData
        """A view into one MjData."""
        view: Float64 = getattr(data, self.name)
        return view if self.row is None else view[self.row]


@dataclass(frozen=True, slots=True)
class Judgement:
    """What one step was worth."""

    reward: Array  # [n]
    terminated: NDArray[np.bool_]  # [n]
    info: Callable[[], dict[str, Array]] = dict
    """Makes what Gymnasium's `info` holds, each [n, ...]: before the next step, if at all."""


class Kind:
    """One Gymnasium class."""

    forces = False
    """Reads what only mj_rnePostConstraint computes: contact forces."""

    def __init__(self, env: Any) -> None:  # noqa: ANN401  weights are private attributes
        """`env`: an unwrapped instance of the Gymnasium class."""
        self.env = env
        self.dt: float = env.dt

    def fields(self) -> dict[str, Field]:
        """What to copy out of MjData after each step."""
        return {"qpos": Field("qpos"), "qvel": Field("qvel")}

    def observe(self, now: State) -> Float64:
        """[n, O] observations."""
        raise NotImplementedError

    def judge(self, before: State, now: State, action: Array) -> Judgement:
        """Rewards and ends of a step from `before` to `now` with actions [n, A]."""
        raise NotImplementedError


def body(env: Any, name: str | int) -> Field:  # noqa: ANN401  as in Kind
    """Position of a body's frame [3]."""
    return Field("xpos", int(env.data.body(name).id))


def norm(vectors: Float64) -> Float64:
    """[n] Euclidean lengths of [n, k], with the bits of np.linalg.norm row by row."""
    rows = np.ascontiguousarray(vectors)
    length: Float64 = np.sqrt(np.vecdot(rows, rows))
    return length


def square_sum(values: Array) -> Array:
    """[n] sums of squares over all other axes, with the bits of a sum row by row."""
    total: Array = np.square(values).reshape(len(values), -1).sum(axis=1)
    return total


def are_finite(values: Array) -> bool:
    """All of them; counting takes a third of the time of `all`."""
    return bool(np.count_nonzero(np.isfinite(values)) == values.size)


def clipped(values: Float64, low: float, high: float) -> Float64:
    """np.clip without its overhead."""
    result: Float64 = np.minimum(np.maximum(values, low), high)
    return result


def motion(xy: Float64, velocity: Float64) -> dict[str, Array]:
    """What `info` tells of a body's place and velocity in the plane, each [n, 2]."""
    return {
        "x_position": xy[:, 0],
        "y_position": xy[:, 1],
        "distance_from_origin": norm(xy),
        "x_velocity": velocity[:, 0],
        "y_velocity": velocity[:, 1],
    }


def never(action: Array) -> NDArray[np.bool_]:
    """[n] no episode terminates."""
    return np.zeros(len(action), np.bool_)
