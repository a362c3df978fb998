"""n simulations of one MuJoCo model, stepped one after the other.

All of them in one call of MuJoCo's own batch, where it is there and will do; else one call each.
Both give the same bits (`tests/processes/test_batched_bits.py`). The batch's threads are not used:
one process has one core.

Shape letters: n simulations · A actuators · S numbers of a state.
"""

from collections.abc import Mapping
from importlib.util import find_spec
from typing import Any, Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from workers.kinds.kind import Field, Float64
from workers.physics import WithoutTimer

Flags = NDArray[np.bool_]
_STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION)


class Simulations(Protocol):
    """Where they are is theirs; what was read out of them is the caller's."""

    def step(self, ctrl: NDArray[Any], active: Flags | None) -> None:
        """One step of some rows (None: all) with controls [n, A]."""

    def read(self, out: Mapping[str, Float64]) -> None:
        """Copy the fields of all rows, [n, ...] each."""

    def state(self, row: int) -> Float64:
        """[S] all that a row's future depends on, besides its controls; a copy."""

    def put(self, row: int, state: NDArray[np.generic]) -> None:
        """Set a row's state."""


def simulations(
    model: mujoco.MjModel, count: int, frames: int, fields: Mapping[str, Field], forces: bool
) -> Simulations:
    """The faster way there is.

    Args:
        model: of all of them.
        count: how many.
        frames: MuJoCo's steps per step.
        fields: what `read` reads.
        forces: whether contact forces are among it, which a batch does not compute.
    """
    is_plain = (
        model.opt.enableflags == 0 and model.nplugin == 0
    )  # sleep, say, needs an MjData each
    if is_plain and not forces and has_batch():
        return Batched(model, count, frames, fields)
    return OneByOne(model, count, frames, fields, forces)


def state_of(model: mujoco.MjModel, data: mujoco.MjData) -> Float64:
    """[S] of one MjData."""
    state = np.empty(mujoco.mj_stateSize(model, _STATE))
    mujoco.mj_getState(model, data, state, _STATE)
    return state


class OneByOne:
    """An MjData for each."""

    def __init__(
        self,
        model: mujoco.MjModel,
        count: int,
        frames: int,
        fields: Mapping[str, Field],
        forces: bool,
    ) -> None:
        """See `simulations`."""
        self._model, self._frames, self._forces = model, frames, forces
        self._without_timer = WithoutTimer()
        self._data = [mujoco.MjData(model) for _ in range(count)]
        self._ctrl = [data.ctrl for data in self._data]
        self._views = {
            name: [field.of(data).reshape(-1) for data in self._data]
            for name, field in fields.items()
        }

    def step(self, ctrl: NDArray[Any], active: Flags | None) -> None:
        """See `Simulations`."""
        model, frames, forces = self._model, self._frames, self._forces
        step, finish = mujoco.mj_step, mujoco.mj_rnePostConstraint
        with self._without_timer:
            for row, (data, own) in enumerate(zip(self._data, self._ctrl, strict=True)):
                if active is None or active[row]:
                    own[:] = ctrl[row]
                    step(model, data, frames)
                    if forces:
                        finish(model, data)

    def read(self, out: Mapping[str, Float64]) -> None:
        """See `Simulations`."""
        for name, views in self._views.items():
            np.concatenate(views, out=out[name].reshape(-1))

    def state(self, row: int) -> Float64:
        """See `Simulations`."""
        return state_of(self._model, self._data[row])

    def put(self, row: int, state: NDArray[np.generic]) -> None:
        """See `Simulations`."""
        mujoco.mj_resetData(self._model, self._data[row])
        mujoco.mj_setState(self._model, self._data[row], state, _STATE)


class Batched:
    """Rows of states, and one MjData that they take turns in."""

    def __init__(
        self, model: mujoco.MjModel, count: int, frames: int, fields: Mapping[str, Field]
    ) -> None:
        """See `simulations`."""
        from mujoco.batch import Batch

        self._batch, self._frames = Batch(model, count, nthread=1), frames
        self._without_timer = WithoutTimer()
        self._states, self._ctrl = self._batch.state, self._batch.bind("ctrl")
        self._views = {}
        for name, field in fields.items():
            view = self._batch.bind(field.name)
            self._views[name] = view if field.row is None else view[:, field.row]

    def step(self, ctrl: NDArray[Any], active: Flags | None) -> None:
        """See `Simulations`."""
        rows = None if active is None else np.flatnonzero(active)
        if rows is None:
            self._ctrl[:] = ctrl
        else:
            self._ctrl[rows] = ctrl[rows]
        with self._without_timer:
            self._batch.step(rows, self._frames)

    def read(self, out: Mapping[str, Float64]) -> None:
        """See `Simulations`."""
        for name, view in self._views.items():
            np.copyto(out[name], view)

    def state(self, row: int) -> Float64:
        """See `Simulations`."""
        state: Float64 = self._states[row].copy()
        return state

    def put(self, row: int, state: NDArray[np.generic]) -> None:
        """See `Simulations`."""
        self._states[row] = state


def has_batch() -> bool:
    """MuJoCo 4.0 has one."""
    return find_spec("mujoco.batch") is not None
