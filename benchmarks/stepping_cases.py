"""The cases of `stepping.py`, each in a process of its own; not to be started by hand.

python -m benchmarks.stepping_cases CASE RECORDING.npz
"""

import ctypes
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import mujoco
import numpy as np
from gymnasium.vector import AutoresetMode

from benchmarks.measuring import Result, serve
from benchmarks.processes import SkippedError
from benchmarks.recording import Recording, quiet, seeds, sync_vector

_LOOP = """
void mj_step(const void* model, void* data);

void run(const void* model, void** data, double** ctrl, const float* action,
         long begin, long end, long envs, long size, long skip) {
  for (long k = begin; k < end; k++)
    for (long i = 0; i < envs; i++) {
      for (long a = 0; a < size; a++) ctrl[i][a] = action[(k * envs + i) * size + a];
      for (long s = 0; s < skip; s++) mj_step(model, data[i]);
    }
}
"""
"""The bare loop in C, for the stretches between two resets."""


class Raw:
    """n MjData, stepped by nothing but `mj_step`; default options, no observations or rewards."""

    def __init__(self, recording: Recording) -> None:
        quiet()
        inner: Any = gymnasium.make(recording.env).unwrapped
        self._recording = recording
        self.model, self.frame_skip = inner.model, inner.frame_skip
        self.data = [mujoco.MjData(self.model) for _ in recording.start]

    def reset(self) -> None:
        """To the recording's start."""
        for data, state in zip(self.data, self._recording.start, strict=True):
            self.place(data, state)

    def place(self, data: Any, state: np.ndarray) -> None:  # noqa: ANN401  an MjData
        """As gymnasium's reset does."""
        mujoco.mj_resetData(self.model, data)
        data.qpos[:], data.qvel[:] = np.split(state, [self.model.nq])
        mujoco.mj_forward(self.model, data)

    def same(self) -> bool:
        """Did this end where gymnasium's environments ended, to the bit?"""
        states = [np.concatenate([data.qpos, data.qvel]) for data in self.data]
        return np.array_equal(np.stack(states), self._recording.last)

    def stretches(self) -> "list[tuple[int, list[tuple[int, int]]]]":
        """Steps up to which nothing ends, and (environment, row of `restart`) that end there."""
        found, row = [], 0
        for k in np.flatnonzero(self._recording.ended.any(axis=1)):
            who = np.flatnonzero(self._recording.ended[k])
            found.append((int(k) + 1, [(int(i), row + n) for n, i in enumerate(who)]))
            row += len(who)
        return [*found, (len(self._recording.ended), [])]


def raw(recording: Recording) -> Callable[[], Result]:
    """`mj_step(model, data, nstep=frame_skip)` from Python."""
    bare = Raw(recording)
    step, model, skip, action = mujoco.mj_step, bare.model, bare.frame_skip, recording.action

    def measure() -> Result:
        bare.reset()
        begun, k = time.perf_counter(), 0
        for end, resets in bare.stretches():
            for now in range(k, end):
                for data, row in zip(bare.data, action[now], strict=True):
                    data.ctrl[:] = row
                    step(model, data, nstep=skip)
            k = end
            for env, restart in resets:
                bare.place(bare.data[env], recording.restart[restart])
        return _speed(recording, begun) | {"same": bare.same()}

    return measure


def raw_c(recording: Recording) -> Callable[[], Result]:
    """The same loop in C, on the same library: no Python between two resets."""
    bare = Raw(recording)
    loop = _compiled(Path(mujoco.__file__).parent)
    datas = (ctypes.c_void_p * len(bare.data))(*(data._address for data in bare.data))
    ctrls = (ctypes.c_void_p * len(bare.data))(*(data.ctrl.ctypes.data for data in bare.data))
    model, action = ctypes.c_void_p(bare.model._address), np.ascontiguousarray(recording.action)
    sizes = [ctypes.c_long(size) for size in (*action.shape[1:], bare.frame_skip)]

    def measure() -> Result:
        bare.reset()
        begun, k = time.perf_counter(), 0
        for end, resets in bare.stretches():
            first = ctypes.c_void_p(action.ctypes.data)
            loop.run(model, datas, ctrls, first, ctypes.c_long(k), ctypes.c_long(end), *sizes)
            k = end
            for env, restart in resets:
                bare.place(bare.data[env], recording.restart[restart])
        return _speed(recording, begun) | {"same": bare.same()}

    return measure


def _compiled(package: Path) -> ctypes.PyDLL:
    """The loop as a library; it keeps Python's lock, which MuJoCo's clock in Python needs."""
    folder = Path(tempfile.mkdtemp(prefix="dppo-raw-"))
    (folder / "raw.c").write_text(_LOOP)
    library = next(package.glob("libmujoco.so*"), None)
    command = ["gcc", "-O2", "-shared", "-fPIC", "raw.c", "-o", "raw.so", str(library)]
    try:
        subprocess.run(command, cwd=folder, check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError) as error:
        raise SkippedError(f"the C loop cannot be compiled: {error}") from error
    return ctypes.PyDLL(str(folder / "raw.so"))


def vector(recording: Recording, envs: Any) -> Callable[[], Result]:  # noqa: ANN401  any vector
    """Any vector environment that takes seeds and resets within the step that ends an episode."""

    def measure() -> Result:
        envs.reset(seed=seeds(recording.action.shape[1]))
        begun = time.perf_counter()
        for action in recording.action:
            obs, *_ = envs.step(action)
        return _speed(recording, begun) | {"same": np.array_equal(obs, recording.last_obs)}

    return measure


def gymnasium_sync(recording: Recording) -> Callable[[], Result]:
    """`SyncVectorEnv`."""
    return vector(recording, sync_vector(recording.env, recording.action.shape[1]))


def ours(recording: Recording) -> Callable[[], Result]:
    """`workers.envs.make_vec`."""
    from workers import envs

    envs.quiet()
    mode = AutoresetMode.SAME_STEP
    made = envs.make_vec(recording.env, recording.action.shape[1], autoreset_mode=mode)
    return vector(recording, made)


def envpool_sync(recording: Recording) -> Callable[[], Result]:
    """EnvPool, synchronous, one thread; its own MuJoCo, so its states drift from ours.

    It begins anew in a step of its own, which steps no physics: that one does not count.
    """
    import envpool

    num_envs = recording.action.shape[1]
    if recording.env not in envpool.list_all_envs():
        raise SkippedError(f"EnvPool has no {recording.env}")
    envs = envpool.make(
        recording.env, env_type="gymnasium", num_envs=num_envs, num_threads=1, seed=1
    )

    def measure() -> Result:
        envs.reset()
        begun, elapsed = time.perf_counter(), []
        for action in recording.action:
            *_, info = envs.step(action)
            elapsed.append(info["elapsed_step"])
        seconds = time.perf_counter() - begun
        return {"steps_per_second": np.count_nonzero(elapsed) / seconds}

    return measure


def _speed(recording: Recording, begun: float) -> Result:
    return {"steps_per_second": recording.steps / (time.perf_counter() - begun)}


CASES = {
    "raw": raw,
    "raw_c": raw_c,
    "gymnasium": gymnasium_sync,
    "envpool": envpool_sync,
    "ours": ours,
}

if __name__ == "__main__":
    name, file = sys.argv[1:]
    serve(lambda: CASES[name](Recording.load(Path(file))))
