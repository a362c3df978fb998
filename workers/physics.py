"""MuJoCo's physics with everything left out that cannot change a bit.

Three things, each proven with trajectories (`tests/processes/test_batched_bits.py`) and measured
(`docs/performance.md`):

- no timer: the bindings install a clock that is read several times per step;
- no islands: in a model of one kinematic tree there is nothing to find;
- explicit contact pairs: the pairs that the broad phase could find, with the parameters that the
  engine would mix, in the order in which it would look at them; for Gymnasium's own files only.

Before `tuned` trusts a model that it has changed, it compares both in some postures: a guard
against another version of MuJoCo or Gymnasium, not a proof.
"""

import contextlib
import ctypes
import logging
import warnings
from copy import copy
from functools import cache
from pathlib import Path

import mujoco
import numpy as np
from gymnasium.envs.mujoco import mujoco_env
from numpy.typing import NDArray

log = logging.getLogger("worker")
_MOST_PAIRS = 64
"""Above this many pairs the broad phase is the faster way (Humanoid has 126)."""
_CHECKED_POSTURES = 64
_ONE_NUMBER = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))


class WithoutTimer:
    """Step without reading a clock; MuJoCo's own timers stay empty meanwhile.

    The bindings' clock is a C global, and `set_mjcb_time(None)` only puts the default clock back.
    """

    def __init__(self) -> None:
        """Nothing changes before it is entered."""
        self._timer = _timer()

    def __enter__(self) -> None:
        """Take the clock away."""
        if self._timer is not None:
            self._timer[0].value = None

    def __exit__(self, *_error: object) -> None:
        """Put it back."""
        if self._timer is not None:
            slot, clock = self._timer
            slot.value = clock


@cache
def _timer() -> tuple[ctypes.c_void_p, int | None] | None:
    """The global `mjcb_time` and what was in it; None where the library does not show it."""
    for path in sorted(Path(mujoco.__file__).parent.glob("libmujoco*")):
        with contextlib.suppress(OSError, ValueError):
            slot = ctypes.c_void_p.in_dll(ctypes.CDLL(str(path)), "mjcb_time")
            return slot, slot.value
    return None


def tuned(path: str, plain: mujoco.MjModel) -> mujoco.MjModel:
    """A model that steps like `plain`, compiled from the same file, only sooner.

    Args:
        path: of the model's XML.
        plain: the model as written; returned if no change to it keeps the bits.
    """
    pairs = contact_pairs(plain) if _is_gymnasiums(path) else None
    if pairs is None or len(pairs) > _MOST_PAIRS:
        model = copy(plain)
    else:
        model = _with_pairs(path, plain, pairs)
    if plain.ntree <= 1:
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ISLAND
    if _steps_alike(plain, model):
        return model
    log.warning("%s keeps its bits only as it is written: stepping it untuned", path)
    return plain


def _is_gymnasiums(path: str) -> bool:
    """A file that comes with Gymnasium: its trajectories are tested pair by pair."""
    return Path(path).resolve().parent == Path(mujoco_env.__file__).resolve().parent / "assets"


def contact_pairs(model: mujoco.MjModel) -> list[tuple[int, int]] | None:
    """The pairs of geoms that may touch, in the engine's order; None: not expressible as pairs."""
    if model.npair or model.nflex or model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_CONTACT:
        return None
    return [
        (first, second)
        for one in range(model.nbody)
        for other in range(one + 1, model.nbody)
        if _bodies_meet(model, one, other)
        for first in _geoms(model, one)
        for second in _geoms(model, other)
        if (model.geom_contype[first] & model.geom_conaffinity[second])
        or (model.geom_contype[second] & model.geom_conaffinity[first])
    ]


def _geoms(model: mujoco.MjModel, body: int) -> range:
    first = int(model.body_geomadr[body])
    return range(first, first + int(model.body_geomnum[body]))


def _bodies_meet(model: mujoco.MjModel, one: int, other: int) -> bool:
    """May geoms of two bodies touch? Not within a rigid part, nor a part and its parent."""
    part, second = model.body_weldid[one], model.body_weldid[other]
    if part == second or (one << 16) + other in model.exclude_signature:
        return False
    if 0 in (part, second) or model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_FILTERPARENT:
        return True
    parent, its_parent = (model.body_weldid[model.body_parentid[p]] for p in (part, second))
    return bool(part != its_parent and second != parent)


def _with_pairs(path: str, plain: mujoco.MjModel, pairs: list[tuple[int, int]]) -> mujoco.MjModel:
    """The model with explicit pairs instead of geoms that look for each other."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what the XML is told was told when `plain` was loaded
        spec = mujoco.MjSpec.from_file(path)
        spec.compile()  # numbers the geoms
        geoms = {geom.id: geom for geom in spec.geoms}
        for number, geom in geoms.items():
            geom.name = geom.name or f"geom-{number}"
            geom.contype = geom.conaffinity = 0
        for first, second in pairs:
            pair = spec.add_pair(geomname1=geoms[first].name, geomname2=geoms[second].name)
            _mix(pair, plain, first, second)
        return spec.compile()


def _mix(pair: "mujoco._specs.MjsPair", model: mujoco.MjModel, first: int, second: int) -> None:
    """The parameters of a contact as the engine mixes them; NaN: the compiler mixes them alike."""
    one, other = (int(model.geom_priority[geom]) for geom in (first, second))
    dims = [int(model.geom_condim[geom]) for geom in (first, second)]
    pair.condim = max(dims) if one == other else dims[0] if one > other else dims[1]
    pair.friction[:] = pair.solref[:] = pair.solimp[:] = np.nan
    pair.solreffriction[:] = 0
    pair.margin = model.geom_margin[first] + model.geom_margin[second]
    pair.gap = model.geom_gap[first] + model.geom_gap[second]


def _steps_alike(plain: mujoco.MjModel, model: mujoco.MjModel) -> bool:
    """Do both models give the same bits from some random postures?"""
    rng = np.random.default_rng(0)
    one, other = mujoco.MjData(plain), mujoco.MjData(model)
    for _ in range(_CHECKED_POSTURES):
        posture = _posture(plain, rng)
        speed, ctrl = rng.normal(0, 1, plain.nv), rng.normal(0, 0.5, plain.nu)
        for each, data in ((plain, one), (model, other)):
            mujoco.mj_resetData(each, data)
            data.qpos[:], data.qvel[:], data.ctrl[:] = posture, speed, ctrl
            mujoco.mj_step(each, data, 2)
        if one.ncon != other.ncon or not np.array_equal(one.qacc, other.qacc, equal_nan=True):
            return False
    return True


def _posture(model: mujoco.MjModel, rng: np.random.Generator) -> NDArray[np.float64]:
    """Joints anywhere in their ranges, or about where the model has them; bodies turned anyhow."""
    qpos: NDArray[np.float64] = model.qpos0 + rng.normal(0, 0.5, model.nq)
    for joint in range(model.njnt):
        first = int(model.jnt_qposadr[joint])
        if model.jnt_limited[joint] and model.jnt_type[joint] in _ONE_NUMBER:
            qpos[first] = rng.uniform(*model.jnt_range[joint])
    mujoco.mj_normalizeQuat(model, qpos)
    return qpos
