"""What an experiment runs: environments x arms x seeds, and in which order."""

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Self

from dppo.config import Config
from dppo.errors import UsageError
from dppo.experiment.settings import Settings, resolved, words_of
from dppo.files import safe_name

_KEY = re.compile(r"[A-Za-z0-9][A-Za-z0-9.+-]{0,99}")
_STEPS_PER_SECOND = {"Ant": 13.6e3, "Walker2d": 21e3, "Hopper": 27e3, "HalfCheetah": 41e3}
"""Of a whole machine (docs/performance.md): a first guess at what takes how long."""
_COMMON = 20e3


@dataclass(frozen=True, slots=True, kw_only=True)
class Run:
    """One training run of the grid."""

    env: str
    arm: str
    """Key of what is compared: the same settings, but for the seed, on one environment."""
    seed: int
    steps: int
    """As asked for; `config` rounds up to whole iterations [env steps]."""
    settings: Settings
    config: Config = field(repr=False)

    @classmethod
    def build(cls, *, env: str, arm: str, seed: int, steps: int, settings: Settings) -> Self:
        """With its settings resolved.

        Raises:
            UsageError: settings that cannot be, or names that cannot be part of a folder's.
        """
        if not _KEY.fullmatch(arm):
            raise UsageError(
                f"an arm is called {arm!r}, expected at most 100 letters, digits, '.', '+' and "
                "'-': it is part of folder names"
            )
        try:
            config = resolved(env, seed, steps, settings)
        except UsageError as error:
            raise UsageError(f"arm {arm} on {env}: {error}") from error
        return cls(env=env, arm=arm, seed=seed, steps=steps, settings=settings, config=config)

    @property
    def name(self) -> str:
        """Of its folder."""
        return f"{safe_name(self.env)}__{self.arm}__s{self.seed}"

    @property
    def psi(self) -> float:
        """ψ."""
        return self.config.safety.psi

    @property
    def is_plain(self) -> bool:
        """No penalty of any kind."""
        safety = self.config.safety
        return self.psi == 0 and math.isinf(safety.variance_limit) and safety.reward_variance == 0

    @property
    def moves_psi(self) -> bool:
        """ψ is on a schedule, or follows a limit."""
        safety = self.config.safety
        return safety.psi_schedule != "constant" or not math.isinf(safety.variance_limit)

    @property
    def weight(self) -> str:
        """ψ as reports name it: of a limit the limit, of a schedule its end."""
        safety = self.config.safety
        text = f"ψ {self.psi:g}"
        if not math.isinf(safety.variance_limit):
            text = f"σ(s_0) ≤ {safety.variance_limit:g}"
        elif safety.psi_schedule != "constant":
            text = f"ψ 0 to {self.psi:g}, {safety.psi_schedule}"
        return text + (f", κ {safety.reward_variance:g}" if safety.reward_variance else "")

    @property
    def real_steps(self) -> int:
        """Whole iterations [env steps]."""
        return self.config.env_steps(self.config.iterations)

    @property
    def words(self) -> list[str]:
        """The flags of dppo-learner that make this run."""
        own = {"env": self.env, "seed": self.seed, "total_timesteps": self.steps}
        preset = {name: value for name, value in self.settings.items() if name == "preset"}
        return words_of({**preset, **own, **self.settings})

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "env": self.env,
            "arm": self.arm,
            "seed": self.seed,
            "steps": self.steps,
            "settings": dict(self.settings),
        }

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Self:
        """The inverse."""
        return cls.build(**{name: values[name] for name in _FIELDS})


_FIELDS = ("env", "arm", "seed", "steps", "settings")


@dataclass(frozen=True, slots=True, kw_only=True)
class Grid:
    """All runs of one experiment."""

    title: str
    runs: tuple[Run, ...]
    baseline: str
    """Key of the arm that others are compared with, on each environment."""
    evaluate: int
    """Evaluation episodes from free start states, and again from a fixed one; 0: none."""

    def __post_init__(self) -> None:
        """Refuse two runs in one folder."""
        names = [run.name for run in self.runs]
        double = sorted({name for name in names if names.count(name) > 1})
        if double:
            raise UsageError(
                f"the grid has {', '.join(double)} twice; give every arm, environment and seed "
                "once"
            )

    @property
    def steps(self) -> int:
        """Of all runs [env steps]."""
        return sum(run.real_steps for run in self.runs)


def guessed_seconds_per_step(env: str) -> float:
    """Before anything is measured; only the ratios between environments matter."""
    base = env.rpartition(":")[2].partition("-v")[0]
    known = [speed for name, speed in _STEPS_PER_SECOND.items() if name in base]
    return 1 / (known[0] if known else _COMMON)


def in_order(runs: Iterable[Run]) -> list[Run]:
    """As they are started: seed by seed, so that a part of the grid is a whole comparison.

    Within a seed the longest first: what is left at the end is short, and no core idles long.
    What takes equally long stays in its order.
    """
    return sorted(
        runs,
        key=lambda run: (
            run.seed,
            -round(run.real_steps * guessed_seconds_per_step(run.env), 6),
        ),
    )


def whole_number(name: str, value: float, least: int) -> int:
    """A count that may be written as 1e6.

    Raises:
        ValueError: it is none.
    """
    if not math.isfinite(value) or value != int(value) or value < least:
        raise ValueError(f"--{name} is {value:g}, expected a whole number >= {least}")
    return int(value)
