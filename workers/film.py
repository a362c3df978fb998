"""Episodes that can be seen: pictures of each step into a file, or a window.

The episodes are those of `workers.play`: number k is the one that `dppo eval` plays with the same
seed.
"""

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from dppo.config import Config
from dppo.errors import UsageError
from dppo.store.checkpoint import Checkpoint
from workers.envs import Adapter, Env, make_env, spaces_of
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
        self, checkpoint: Checkpoint, mode: Literal["rgb_array", "human"], deterministic: bool
    ) -> None:
        config = Config.from_dict(checkpoint.facts["config"])
        kwargs = json.loads(config.run.env_kwargs) | {"render_mode": mode}
        self.env: Env = make_env(replace(config.run, env_kwargs=json.dumps(kwargs)))
        self._policy = FrozenPolicy(checkpoint, spaces_of(self.env))
        self._adapter = Adapter(self.env.observation_space, self.env.action_space)
        self._deterministic = deterministic

    @property
    def pictures_per_second(self) -> float:
        """Of the environment: one picture per step."""
        return float(self.env.metadata.get("render_fps") or _MOST_PICTURES_PER_SECOND)

    def play(self, seed: int, number: int, each: Callable[[int], None]) -> Shown:
        """One episode; `each` is called with the number of steps so far, before each of them."""
        plan = Plan(seed, "free", 0, number)
        rng = None if self._deterministic else plan.noise()
        observation, _ = self.env.reset(seed=plan.reset_seed)
        total, steps, over, terminated = 0.0, 0, False, False
        while not over:
            each(steps)
            action = self._policy.act(self._adapter.obs(observation), steps, rng)
            observation, reward, terminated, truncated, _ = self.env.step(
                self._adapter.to_env(action)
            )
            total, steps, over = total + float(reward), steps + 1, terminated or truncated
        return Shown(total, steps, bool(terminated))

    def picture(self) -> Picture:
        """What the environment looks like now.

        Raises:
            UsageError: nothing can be rendered on this machine, or the environment cannot.
        """
        try:
            found: Any = self.env.render()
        except Exception as error:  # drivers and environments raise what they like
            raise UsageError(
                f"no picture can be made here ({type(error).__name__}: {error}); {_ADVICE}"
            ) from error
        if not isinstance(found, np.ndarray) or found.ndim != 3:
            raise UsageError("the environment renders no pictures (rgb_array); nothing to film")
        return found


class Film:
    """A file of pictures, .mp4 or .gif by its name."""

    def __init__(self, path: Path, pictures_per_second: float) -> None:
        """Environments with more pictures per second than a film has are seen in every k-th step.

        Raises:
            UsageError: another kind of file, or the package for it is not installed.
        """
        if path.suffix not in (".mp4", ".gif"):
            raise UsageError(f"--out is {path}, expected a name that ends in .mp4 or .gif")
        if not path.absolute().parent.is_dir():
            raise UsageError(f"{path} lies in no folder that exists; make the folder first")
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
        self._writer = imageio.v2.get_writer(path, **options)

    def add(self, picture: Picture) -> None:
        """One more picture."""
        self._writer.append_data(picture)

    def close(self) -> None:
        """Finish the file."""
        self._writer.close()


def film(
    checkpoint: Checkpoint, path: Path, *, episodes: int, seed: int, deterministic: bool
) -> Iterator[Shown]:
    """Write episodes into one file, one after the other.

    Raises:
        UsageError: nothing can be rendered here, or not into such a file.
    """
    stage = Stage(checkpoint, "rgb_array", deterministic)
    stage.env.reset(seed=0)
    stage.picture()  # before there is a file
    writer = Film(path, stage.pictures_per_second)

    def each(steps: int) -> None:
        if steps % writer.every == 0:
            writer.add(stage.picture())

    try:
        for number in range(episodes):
            yield stage.play(seed, number, each)
    finally:
        writer.close()
        stage.env.close()
