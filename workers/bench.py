"""How fast this machine steps an environment, and what that means for the settings.

The short form of `benchmarks/`, for users. Raw is a bare loop of `mj_step` from Python, with
MuJoCo's default options and the same actions: physics and nothing else.
"""

import json
import os
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from dppo.children import answers, children
from dppo.config import Config, RunConfig
from dppo.errors import RunFailedError
from dppo.machine import THREAD_VARIABLES, usable_cores
from workers.envs import make_env, make_vec, quiet, spaces_of

Ends = list[NDArray[np.bool_]]
"""Which rows ended after each step."""
_ROWS = (1, 2, 4, 8, 16, 32)
"""Numbers of environments that are stepped side by side."""
_CYCLE = 256
"""Steps after which the actions repeat."""
_WAIT_SECONDS = 60.0


@dataclass(frozen=True)
class Bench:
    """What was measured, in environment steps per second."""

    env: str
    cores: int
    """That this process may use."""
    quota: float
    """Cores' worth of time that the container may use; at most `cores`."""
    load: float
    """Load average before the measurement: processes that wanted a core."""
    raw: float | None
    """A bare `mj_step` loop on one core; None: not a MuJoCo environment."""
    one_process: dict[int, float]
    """By number of environments that one process steps side by side."""
    all_cores: float
    """One process per core at the same time, all together."""
    threads: dict[str, str]
    """Thread variables that were set for this command to something else than 1."""

    def to_json(self) -> str:
        """One line."""
        return json.dumps(asdict(self) | {"advice": list(self.advice())})

    @property
    def best(self) -> int:
        """Environments side by side that one process steps fastest."""
        return max(self.one_process, key=lambda rows: self.one_process[rows])

    @property
    def gain(self) -> float:
        """What all cores step together, in units of one process alone."""
        return self.all_cores / self.one_process[self.best]

    def lines(self) -> Iterator[str]:
        """For people."""
        yield f"{self.env} on {self.cores} cores, environment steps per second"
        if self.raw is not None:
            yield f"  raw mj_step, one core        {self.raw:10,.0f}"
        for rows, speed in self.one_process.items():
            share = "" if self.raw is None else f"  {speed / self.raw:5.2f} of raw"
            yield f"  one process, {rows:2} environments {speed:10,.0f}{share}"
        yield f"  one process on each core     {self.all_cores:10,.0f}  {self.gain:5.2f} processes"

    def advice(self) -> Iterator[str]:
        """Sentences, the most important first."""
        rollout = Config().rollout
        if self.quota < self.cores:
            yield (
                f"the container may use {self.quota:g} cores' worth of time: start "
                f"--local-workers {max(1, round(self.quota))}, not one per core"
            )
        if self.load > 0.5 * self.cores:
            yield (
                f"{self.load:.1f} processes wanted a core before this began: training shares the "
                f"{self.cores} cores with them and the slowest worker sets the pace"
            )
        if self.gain < 0.75 * self.quota:
            yield (
                f"{self.cores} processes step only {self.gain:.1f} times as much as one: the "
                "cores are hyperthreads or busy; half as many --local-workers may be as fast"
            )
        workers = min(self.cores, rollout.slots)
        yield f"--local-workers {workers} is the default here: one per core, at most --slots"
        if self.cores > rollout.slots:
            yield (
                f"--slots {rollout.slots} leaves {self.cores - rollout.slots} cores idle; --slots "
                f"{self.cores} uses them, with a larger batch and other results"
            )
        held = -(-rollout.slots // workers) * rollout.num_envs
        now = self.one_process[max(rows for rows in self.one_process if rows <= held)]
        if self.best > held and self.one_process[self.best] > 1.1 * now:
            num_envs = rollout.num_envs * self.best // held
            yield (
                f"{workers} workers step {held} environments each, {self.best} would step "
                f"{self.one_process[self.best] / now:.2f} times as fast: --num-envs {num_envs} "
                f"--num-steps {rollout.samples_per_slot // num_envs}, with the same batch and "
                "other results"
            )
        for name, value in self.threads.items():
            yield f"{name}={value} does not matter: every process of dppo computes on one thread"


def bench(env_id: str, seconds: float) -> Bench:
    """Measure for about `seconds` per line.

    Raises:
        UsageError: no such environment.
        RunFailedError: the processes that were started did not answer.
    """
    quiet()
    load = os.getloadavg()[0]
    env = make_env(RunConfig(env=env_id))
    spaces_of(env)
    speeds, ends = {}, Ends()
    for rows in _ROWS:
        speeds[rows], ends = stepped(env_id, rows, seconds)
    raw = _raw(env, ends)
    env.close()
    cores = usable_cores()
    best = max(speeds, key=lambda rows: speeds[rows])
    return Bench(
        env=env_id,
        cores=cores,
        quota=_quota(Path("/sys/fs/cgroup/cpu.max"), cores),
        load=load,
        raw=raw,
        one_process=speeds,
        all_cores=_on_all(cores, env_id, best, seconds),
        threads=_inherited(),
    )


def stepped(env_id: str, rows: int, seconds: float) -> tuple[float, Ends]:
    """Speed of one vector environment; which rows ended after each of its steps."""
    vec = make_vec(env_id, rows, autoreset_mode=AutoresetMode.SAME_STEP)
    actions, ends = _actions(vec.single_action_space, rows), Ends()
    vec.reset(seed=0)
    begun = time.perf_counter()
    while (spent := time.perf_counter() - begun) < seconds:
        _, _, terminated, truncated, _ = vec.step(actions[len(ends) % len(actions)])
        ends.append(terminated | truncated)
    vec.close()
    return rows * len(ends) / spent, ends


def _actions(space: gymnasium.Space[Any], rows: int) -> list[Any]:
    """Some steps' actions: noise of .3 of the border, or any of a discrete space."""
    batch = batch_space(space, rows)
    batch.seed(0)
    if not isinstance(space, gymnasium.spaces.Box):
        return [batch.sample() for _ in range(_CYCLE)]
    high = np.where(np.isfinite(space.high), space.high, 1.0)
    noise = np.random.default_rng(0).standard_normal((_CYCLE, rows, *space.shape))
    return list(np.clip(0.3 * high * noise, space.low, space.high).astype(space.dtype))


def _raw(env: gymnasium.Env[Any, Any], ends: Ends) -> float | None:
    """Speed of bare `mj_step`: the same actions, begun anew where the vector's rows ended."""
    inner: Any = env.unwrapped
    if not (hasattr(inner, "model") and hasattr(inner, "frame_skip")):
        return None
    import mujoco  # not every environment needs it

    env.reset(seed=0)
    model, start = inner.model, (inner.data.qpos.copy(), inner.data.qvel.copy())
    rows = [mujoco.MjData(model) for _ in ends[0]]
    actions = _actions(env.action_space, len(rows))

    def begin(data: Any) -> None:  # noqa: ANN401  an MjData
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:] = start

    for data in rows:
        begin(data)
    begun = time.perf_counter()
    for number, ended in enumerate(ends):
        for data, action in zip(rows, actions[number % _CYCLE], strict=True):
            data.ctrl[:] = action
            mujoco.mj_step(model, data, inner.frame_skip)
        for row in np.flatnonzero(ended):
            begin(rows[row])
    return len(rows) * len(ends) / (time.perf_counter() - begun)


def _on_all(cores: int, env_id: str, rows: int, seconds: float) -> float:
    """One process per core at the same time; their speeds added.

    Raises:
        RunFailedError: they did not answer.
    """
    task, patience = {"env_id": env_id, "rows": rows, "seconds": seconds}, _WAIT_SECONDS + seconds
    ready, speeds = 0, 0.0
    with children("workers.bench_process", [task] * cores) as started:
        try:
            for answer in answers(started, patience):
                if "speed" in answer.facts:
                    speeds += answer.facts["speed"]
                    continue
                ready += 1
                for child in started if ready == cores else ():  # none steps alone
                    child.go()
        except TimeoutError as error:
            raise RunFailedError(
                f"{cores} processes were started to step {env_id}, and not all of them answered "
                f"within {patience:g} s; is there memory for all?"
            ) from error
        except EOFError as error:
            raise RunFailedError(
                f"{cores} processes were started to step {env_id}, and one of them has died; is "
                "there memory for all? If so, see what it printed above"
            ) from error
    return speeds


def _quota(file: Path, cores: int) -> float:
    """Cores' worth of time in a container's cpu.max, at most `cores`."""
    try:
        most, period = file.read_text().split()
    except (OSError, ValueError):
        return float(cores)
    return float(cores) if most == "max" else min(int(most) / int(period), float(cores))


def _inherited() -> dict[str, str]:
    """Thread variables as they were when this process was started."""
    try:
        words = Path("/proc/self/environ").read_text().split("\0")
    except OSError:
        return {}
    found = dict(word.partition("=")[::2] for word in words)
    return {name: found[name] for name in THREAD_VARIABLES if found.get(name, "1") != "1"}
