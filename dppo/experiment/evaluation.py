"""evaluation.json: what `dppo eval --json` says of a finished run, in one form.

    {"settings": {...},                checkpoint and seed, among others; may be missing
     "episodes": [{"start": "free", "return": 1.0, "length": 10,
                   "discounted_return": 0.9, "terminated": true}, ...],
     "calibration": {...}}             as `dppo eval` has it; may be missing

Every episode has a start, a return and a length. What else is missing in it is missing in the
report, too.
"""

from pathlib import Path
from typing import Any

from dppo.config import Config

_ALWAYS = {"return": float, "length": int}
_SETTINGS = ("env", "checkpoint", "env_steps", "actions", "action_std", "gamma", "seed")
_MOST_STEPS = 100_000
"""An episode that nothing ends is cut: an environment need not have a time limit."""
_PERHAPS = ("discounted_return", "terminated")


def evaluation_words(run_dir: Path, config: Config, episodes: int) -> list[str]:
    """The command for a run: its last policy, actions sampled as in training."""
    words = ["eval", str(run_dir), "--which", "newest", "--episodes", str(episodes), "--json"]
    words += ["--fixed-start", "--max-steps", str(_MOST_STEPS)]
    returns = config.returns
    is_variance = (returns.gamma_bar, returns.delta_reward) == ("paper", "scaled")
    if config.safety.variance_critic and is_variance and episodes > 1:
        words.append("--calibration")  # of other runs σ is not the variance of a return
    return words


def normalised(values: Any) -> dict[str, Any]:  # noqa: ANN401  any JSON
    """What `dppo eval --json` has printed, as evaluation.json.

    Raises:
        ValueError: it has no episodes.
    """
    if not isinstance(values, dict):
        raise ValueError(f"found a {type(values).__name__}, expected an object")
    episodes = values.get("episodes")
    if not isinstance(episodes, list) or not episodes:
        raise ValueError(f"found {', '.join(values) or 'nothing'}, expected episodes")
    settings = {name: values[name] for name in _SETTINGS if name in values}
    found: dict[str, Any] = {"settings": settings} if settings else {}
    found["episodes"] = [_episode(one) for one in episodes]
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
