"""Returns of a frozen policy: what `dppo eval` prints."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dppo.statistics import Measure, intervals, spread, tail_mean, wilson_interval
from dppo.store.checkpoint import Checkpoint
from dppo.store.contents import config_in
from dppo.streams import stream
from workers.envs import make_env, spaces_of
from workers.play import ROWS, Episode, Plan, Start, Trajectory, play
from workers.policy import FrozenPolicy

Float64 = NDArray[np.float64]
_BOOTSTRAP = 1
"""Third index of the stream that intervals are drawn from; see `workers.play.Plan.noise`."""
_MEASURES: dict[str, Measure] = {
    "mean": lambda values: values.mean(axis=-1),
    "std": spread,
    "median": lambda values: np.asarray(np.median(values, axis=-1)),
    "cvar10": tail_mean,
}


@dataclass(frozen=True, slots=True)
class Evaluation:
    """Episodes of one policy, free starts first, each kind in order."""

    episodes: tuple[Episode, ...]
    seed: int

    def starts(self) -> list[Start]:
        """The kinds of starts there are."""
        return list(dict.fromkeys(episode.plan.start for episode in self.episodes))

    def summary(self, start: Start) -> dict[str, Any]:
        """Mean, spread and tail of the episodes with this start, with 95 % intervals.

        By bootstrap, and Wilson's of the share of falls. A single episode has no spread and no
        intervals: None.
        """
        chosen = [episode for episode in self.episodes if episode.plan.start == start]
        found: dict[str, Any] = {"episodes": len(chosen)}
        for name, values in (
            ("return", np.array([episode.total for episode in chosen])),
            ("discounted", np.array([episode.discounted for episode in chosen])),
        ):
            found |= self._figures(name, values, _MEASURES)
            found |= {f"{name}_min": float(values.min()), f"{name}_max": float(values.max())}
        falls = sum(episode.terminated for episode in chosen)
        found["falls"] = falls / len(chosen)
        found["falls_interval"] = list(wilson_interval(falls, len(chosen)))
        lengths = np.array([float(episode.length) for episode in chosen])
        found |= self._figures("length", lengths, {"mean": _MEASURES["mean"]})
        if len(chosen) == 1:
            unknown = (name for name in found if name.endswith(("_std", "_interval")))
            found |= dict.fromkeys(unknown)
        return found

    def _figures(
        self, name: str, values: Float64, measures: dict[str, Measure]
    ) -> dict[str, float | list[float]]:
        rng = stream(self.seed, "evaluation", 0, 0, _BOOTSTRAP)
        found: dict[str, float | list[float]] = {}
        for measure, bounds in intervals(values, measures, rng).items():
            key = f"{name}_{measure}"
            found |= {key: float(measures[measure](values)), f"{key}_interval": list(bounds)}
        return found

    def to_dict(self) -> dict[str, Any]:
        """Summaries and every episode."""
        return {
            "summary": {start: self.summary(start) for start in self.starts()},
            "episodes": [
                {
                    "start": episode.plan.start,
                    "place": episode.plan.place,
                    "reset_seed": episode.plan.reset_seed,
                    "return": episode.total,
                    "discounted_return": episode.discounted,
                    "length": episode.length,
                    "terminated": episode.terminated,
                }
                for episode in self.episodes
            ],
        }

    def lines(self) -> list[str]:
        """The summaries, for people."""
        lines = []
        for start in self.starts():
            summary = self.summary(start)
            kind = "free starts" if start == "free" else "the same start"
            count = summary.pop("episodes")
            words = "1 episode" if count == 1 else f"{count} episodes"
            lines.append(f"{words}, {kind}" + ("" if count == 1 else "; [95 % interval]"))
            for name, value in summary.items():
                if value is None or name.endswith("_interval"):
                    continue
                bounds = summary.get(f"{name}_interval")
                interval = "" if bounds is None else f"  [{bounds[0]:.6g}, {bounds[1]:.6g}]"
                lines.append(f"  {name:18} {value:<12.6g}{interval}".rstrip())
        return lines


def policy_of(checkpoint: Checkpoint, env: str = "", env_kwargs: str = "") -> FrozenPolicy:
    """The checkpoint's policy, for the environment of its run or another one.

    Args:
        checkpoint: of the run.
        env: Gymnasium id of an environment of the same sizes; empty: the run's.
        env_kwargs: of the environment, as JSON; empty: the run's, or none if it is another `env`.

    Raises:
        UsageError: the environment cannot be made, or is not of the policy's sizes.
    """
    trained = config_in(checkpoint).run
    is_another = env not in ("", trained.env)
    kwargs = env_kwargs or ("{}" if is_another else trained.env_kwargs)
    run = replace(trained, env=env or trained.env, env_kwargs=kwargs)
    made = make_env(run)
    spaces = spaces_of(made)
    made.close()
    return FrozenPolicy(checkpoint, spaces, run)


def plans_of(seed: int, episodes: int, places: int, free: bool = True) -> list[Plan]:
    """So many episodes of free starts, and so many from each of some fixed ones."""
    plans = [Plan(seed, "free", 0, number) for number in range(episodes if free else 0)]
    return plans + [
        Plan(seed, "fixed", place, number) for place in range(places) for number in range(episodes)
    ]


def evaluate(
    policy: FrozenPolicy,
    *,
    episodes: int,
    deterministic: bool,
    seed: int,
    places: int = 0,
    rows: int = ROWS,
    max_steps: int = 0,
    watch: Callable[[Episode, Trajectory], None] | None = None,
) -> Evaluation:
    """Run the policy for some episodes. Equal arguments give equal returns, for any `rows`.

    Args:
        policy: see `policy_of`.
        episodes: of each kind of start.
        deterministic: take the most likely actions instead of samples.
        seed: of start states, actions and the environments' own noise.
        places: fixed start states; 0: only free ones.
        rows: most environments side by side.
        max_steps: cut episodes after so many steps; 0: as the environment says.
        watch: called with each episode from a fixed start, as they end.
    """
    plans = plans_of(seed, episodes, places)
    free, fixed = plans[:episodes], plans[episodes:]
    part = partial(play, policy, deterministic=deterministic, rows=rows, max_steps=max_steps)
    found = [episode for episode, _ in part(free)]
    if fixed:
        for episode, trajectory in part(fixed, keep=watch is not None):
            found.append(episode)
            if watch is not None:
                watch(episode, trajectory)
    return Evaluation(in_order(plans, found), seed)


def in_order(plans: Sequence[Plan], episodes: Sequence[Episode]) -> tuple[Episode, ...]:
    """Episodes as they were planned, not as they ended."""
    found = {episode.plan: episode for episode in episodes}
    return tuple(found[plan] for plan in plans)
