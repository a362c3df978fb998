"""`dppo video` and `dppo watch`: a run's policy, seen."""

import os
import sys
import warnings
from dataclasses import dataclass
from pathlib import Path

from dppo.arguments import RunFolder
from dppo.config import require_seed
from dppo.settings import require
from workers.commands.targets import check_targets


@dataclass(frozen=True, kw_only=True)
class _Args:
    """What both have."""

    run: RunFolder
    """Run directory, or one checkpoint folder in it."""
    episodes: int = 1
    """Episodes, those of `dppo eval` with the same seed [count]."""
    deterministic: bool = False
    """Take the most likely action instead of sampling."""
    which: str = "best"
    """best, newest, or a checkpoint's name such as iteration-00000040."""
    seed: int = 0
    """Of start states and actions."""
    max_steps: int = 0
    """Cut each episode after so many steps, as a time limit does; 0: as the environment says."""

    def __post_init__(self) -> None:
        """Refuse what cannot be run."""
        require(self.episodes >= 1, "episodes", self.episodes, ">= 1")
        require(self.max_steps >= 0, "max_steps", self.max_steps, ">= 0")
        require_seed(self.seed)


@dataclass(frozen=True, kw_only=True)
class VideoArgs(_Args):
    """Film a run's policy; needs no screen and no GPU."""

    out: str
    """File to write: .mp4 (needs the extra `video`) or .gif."""


@dataclass(frozen=True, kw_only=True)
class WatchArgs(_Args):
    """Watch a run's policy in a window, until Ctrl-C or the last episode."""

    episodes: int = 100
    """Episodes, those of `dppo eval` with the same seed [count]."""


def run_video(args: VideoArgs) -> int:
    """Film, and say what is in the file."""
    check_targets(args.out)
    _draw_unseen()
    from dppo.store.contents import chosen
    from workers.envs import quiet
    from workers.film import film

    quiet()
    path, checkpoint = chosen(args.run, args.which)
    shown = list(
        film(
            checkpoint,
            Path(args.out),
            episodes=args.episodes,
            seed=args.seed,
            deterministic=args.deterministic,
            max_steps=args.max_steps,
        )
    )
    for number, episode in enumerate(shown):
        print(f"episode {number}: {episode.length} steps, return {episode.total:.6g}")
    print(f"{args.out}: {path.name} of {args.run}")
    return 0


def _draw_unseen() -> None:
    """Let MuJoCo draw without a window, if there is MuJoCo.

    Raises:
        UsageError: what MUJOCO_GL asks for is not there.
    """
    from dppo.errors import UsageError
    from dppo.machine import draw_unseen

    draw_unseen()
    # a viewer that could not be made complains once more when it is thrown away
    sys.unraisablehook = lambda _: None
    try:
        import mujoco  # noqa: F401
    except ModuleNotFoundError:
        return
    except Exception as error:  # of the libraries for drawing, whatever they are
        raise UsageError(
            f"MUJOCO_GL is {os.environ.get('MUJOCO_GL')!r}, which does not work here "
            f"({type(error).__name__}: {error}); expected egl, with libEGL, or osmesa, with "
            "libOSMesa: install one of them and unset MUJOCO_GL"
        ) from error


def run_watch(args: WatchArgs) -> int:
    """Open a window and play."""
    _find_screen()
    from dppo.store.contents import chosen
    from workers.envs import quiet
    from workers.film import Stage

    quiet()
    path, checkpoint = chosen(args.run, args.which)
    stage = Stage(checkpoint, "human", args.deterministic, args.max_steps)
    print(f"{path.name} of {args.run}; Ctrl-C ends", flush=True)
    for number in range(args.episodes):
        shown = stage.play(args.seed, number, lambda _steps: None)
        print(f"episode {number}: {shown.length} steps, return {shown.total:.6g}", flush=True)
    return 0


def _find_screen() -> None:
    """Try the screen: without one, what draws ends the process with an assertion in C.

    Raises:
        UsageError: there is none, or none that can be used.
    """
    from dppo.errors import UsageError

    advice = "film the policy with dppo video RUN --out FILE.gif, or watch it where there is one"
    names = ("DISPLAY", "WAYLAND_DISPLAY")
    if sys.platform == "linux" and not any(map(os.environ.get, names)):
        raise UsageError(
            f"there is no screen here: neither DISPLAY nor WAYLAND_DISPLAY is set; {advice}"
        )
    try:
        import glfw
    except ImportError:  # who draws with it will say so, and others may do without
        return
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # pyGLFW's own words for the same
        usable = bool(glfw.init() and glfw.get_primary_monitor())
        glfw.terminate()
    if not usable:
        found = ", ".join(f"{name} {os.environ[name]}" for name in names if name in os.environ)
        raise UsageError(
            f"the screen cannot be used ({found or 'no monitor'}), expected one that shows "
            f"windows; {advice}"
        )
