"""evaluation.json: what `dppo eval --json` says of a finished run, in one form.

    {"settings": {...},                what was asked for
     "episodes": [{"start": "free", "return": 1.0, "length": 10,
                   "discounted_return": 0.9, "terminated": true}, ...],
     "calibration": {...}}             as `dppo eval` has it; may be missing

Every episode has a start, a return and a length. What else is missing in it is missing in the
report, too.
"""

import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from dppo.config import Config

_ALWAYS = {"return": float, "length": int}
_PERHAPS = ("discounted_return", "terminated")


@dataclass(frozen=True, slots=True)
class Evaluator:
    """How finished runs are evaluated."""

    episodes: int
    """From free start states, and again from a fixed one; 0: no evaluation."""
    flags: frozenset[str]
    """What `dppo eval` can do here."""

    @classmethod
    def here(cls, episodes: int) -> Self:
        """With the flags that its help names."""
        command = [sys.executable, "-m", "dppo", "eval", "--help"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        return cls(episodes, frozenset(re.findall(r"--[a-z][a-z-]*", done.stdout)))

    def words(self, run_dir: Path, config: Config) -> list[str]:
        """The command for a run: its last policy, actions sampled as in training."""
        words = ["eval", str(run_dir), "--which", "newest", "--episodes", str(self.episodes)]
        words.append("--json")
        returns, wanted = config.returns, ["--fixed-start"]
        is_variance = (returns.gamma_bar, returns.delta_reward) == ("paper", "scaled")
        if config.safety.variance_critic and is_variance and self.episodes > 1:
            wanted.append("--calibration")  # of other runs σ is not the variance of a return
        return words + [flag for flag in wanted if flag in self.flags]


def normalised(values: Any) -> dict[str, Any]:  # noqa: ANN401  any JSON
    """What `dppo eval --json` has printed, as evaluation.json.

    Raises:
        ValueError: it has no episodes.
    """
    if not isinstance(values, dict):
        raise ValueError(f"found a {type(values).__name__}, expected an object")
    episodes = values.get("episodes")
    if not isinstance(episodes, list):  # lists side by side
        episodes = [
            {"return": score, "length": length}
            for score, length in zip(
                values.get("returns", []), values.get("lengths", []), strict=True
            )
        ]
    if not episodes:
        raise ValueError(f"found {', '.join(values) or 'nothing'}, expected episodes")
    found: dict[str, Any] = {"episodes": [_episode(one) for one in episodes]}
    if isinstance(values.get("calibration"), dict):
        found["calibration"] = values["calibration"]
    return found


def _episode(one: Any) -> dict[str, Any]:  # noqa: ANN401  any JSON
    try:
        episode = {name: kind(one[name]) for name, kind in _ALWAYS.items()}
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"an episode is {one!r}, expected return and length") from error
    rest = {name: one[name] for name in _PERHAPS if one.get(name) is not None}
    return {"start": str(one.get("start", "free")), **episode, **rest}
