"""Episodes that can be seen: pictures of each step into a file, or a window.

The episodes are those of `workers.play`: number k is the one that `dppo eval` plays with the same
seed.
"""

import contextlib
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from gymnasium.error import DependencyNotInstalled
from numpy.typing import NDArray

from dppo.errors import UsageError
from dppo.store.checkpoint import Checkpoint
from dppo.store.contents import config_in
from workers.envs import Adapter, Env, make_env, name_of, spaces_of
from workers.failures import failed_episode
from workers.play import Plan
from workers.policy import FrozenPolicy

Picture = NDArray[np.uint8]
_MOST_PICTURES_PER_SECOND = 30.0
_ADVICE = (
    "MUJOCO_GL chooses how: egl (needs libEGL) or osmesa (needs libOSMesa) work without a screen "
    "and without a GPU"
)


@dataclass(frozen=True, slots=True)
class Shown:
    """What became of an episode."""

    total: float
    length: int
    terminated: bool


class Stage:
    """One environment that renders, and the policy in it."""

    def __init__(
        self,
        checkpoint: Checkpoint,
        mode: Literal["rgb_array", "human"],
        deterministic: bool,
        max_steps: int = 0,
    ) -> None:
        """`max_steps`: cut episodes after so many; 0: as the environment says."""
        config = config_in(checkpoint)
        kwargs = json.loads(config.run.env_kwargs) | {"render_mode": mode}
        self.env: Env = make_env(replace(config.run, env_kwargs=json.dumps(kwargs)))
        self._policy = FrozenPolicy(checkpoint, spaces_of(self.env))
        self._adapter = Adapter(self.env.observation_space, self.env.action_space)
        self._deterministic, self._max_steps = deterministic, max_steps

    @property
    def pictures_per_second(self) -> float:
        """Of the environment: one picture per step."""
        return float(self.env.metadata.get("render_fps") or _MOST_PICTURES_PER_SECOND)

    def play(self, seed: int, number: int, each: Callable[[int], None]) -> Shown:
        """One episode; `each` is called with the number of steps so far, before each of them.

        Raises:
            UsageError: the environment draws with a package that is not installed.
            RunFailedError: the environment raised.
        """
        plan = Plan(seed, "free", 0, number)
        rng = None if self._deterministic else plan.noise()
        with self._blamed(0, plan.reset_seed):
            observation, _ = self.env.reset(seed=plan.reset_seed)
        total, steps, over, terminated = 0.0, 0, False, False
        while not over:
            each(steps)
            action = self._policy.act(self._adapter.obs(observation), steps, rng)
            with self._blamed(steps, plan.reset_seed):
                observation, reward, terminated, truncated, _ = self.env.step(
                    self._adapter.to_env(action)
                )
            total, steps = total + float(reward), steps + 1
            over = terminated or truncated or steps == self._max_steps
        return Shown(total, steps, bool(terminated))

    def rehearse(self) -> None:
        """Reset, and draw once, before anything is written.

        Raises:
            UsageError: nothing can be rendered here.
            RunFailedError: the environment raised.
        """
        with self._blamed(0, 0):
            self.env.reset(seed=0)
        self.picture()

    @contextlib.contextmanager
    def _blamed(self, step: int, seed: int) -> Iterator[None]:
        """What the environment raises, as our errors."""
        name = name_of(self.env)
        try:
            yield
        except DependencyNotInstalled as error:
            raise UsageError(f"{name} cannot be shown here: {error}") from error
        except Exception as error:  # an environment may raise anything
            what = f"raised {type(error).__name__}: {error}"
            raise failed_episode(name, what, step, seed) from error

    def picture(self) -> Picture:
        """What the environment looks like now.

        Raises:
            UsageError: nothing can be rendered on this machine, or the environment cannot.
        """
        try:
            found: Any = self.env.render()
        except DependencyNotInstalled as error:
            raise UsageError(f"no picture can be made here: {error}") from error
        except Exception as error:  # drivers and environments raise what they like
            raise UsageError(
                f"no picture can be made here ({type(error).__name__}: {error}); {_ADVICE}"
            ) from error
        if not isinstance(found, np.ndarray) or found.ndim != 3:
            raise UsageError("the environment renders no pictures (rgb_array); nothing to film")
        return found


class Film:
    """A file of pictures, .mp4 or .gif by its name, which it gets once it is whole.

    To be used with `with`: what is left by an exception is removed, and a file that was there
    before stays.
    """

    def __init__(self, path: Path, pictures_per_second: float) -> None:
        """Environments with more pictures per second than a film has are seen in every k-th step.

        Raises:
            UsageError: another kind of file, or the package for it is not installed.
        """
        if path.suffix not in (".mp4", ".gif"):
            raise UsageError(f"--out is {path}, expected a name that ends in .mp4 or .gif")
        self.every = max(1, int(np.ceil(pictures_per_second / _MOST_PICTURES_PER_SECOND)))
        rate = pictures_per_second / self.every
        try:
            import imageio.v2

            if path.suffix == ".mp4":
                import imageio_ffmpeg  # noqa: F401  imageio needs it, and would name others too
        except ImportError as error:
            raise UsageError(
                f"a {path.suffix} file needs the package {error.name}, which is not installed; "
                "pip install 'dppo[video]'"
            ) from error
        options: dict[str, Any] = {"duration": 1000 / rate, "loop": 0}
        if path.suffix == ".mp4":
            options = {"fps": rate, "macro_block_size": 2}
        self._path, self._part = path, path.with_name(f".{path.stem}.part{path.suffix}")
        self._writer = imageio.v2.get_writer(self._part, **options)

    def add(self, picture: Picture) -> None:
        """One more picture."""
        self._writer.append_data(picture)

    def __enter__(self) -> "Film":
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        try:
            self._writer.close()
            if kind is None:
                self._part.replace(self._path)
        finally:
            self._part.unlink(missing_ok=True)


def film(
    checkpoint: Checkpoint,
    path: Path,
    *,
    episodes: int,
    seed: int,
    deterministic: bool,
    max_steps: int = 0,
) -> Iterator[Shown]:
    """Write episodes into one file, one after the other, each with its last state.

    Raises:
        UsageError: nothing can be rendered here, or not into such a file.
        RunFailedError: the environment raised; nothing is written.
    """
    stage = Stage(checkpoint, "rgb_array", deterministic, max_steps)
    try:
        stage.rehearse()  # before there is a file
        with Film(path, stage.pictures_per_second) as writer:

            def each(steps: int) -> None:
                if steps % writer.every == 0:
                    writer.add(stage.picture())

            for number in range(episodes):
                shown = stage.play(seed, number, each)
                writer.add(stage.picture())
                yield shown
    finally:
        stage.env.close()
