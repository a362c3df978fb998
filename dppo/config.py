"""One run's settings, and their form as JSON or TOML.

The learner decides these and sends them to every worker, so two processes cannot disagree. What
belongs to one process alone (addresses, folders, how many local workers) stands in that process's
own `__main__`.
"""

import dataclasses
import json
import math
from dataclasses import dataclass, field
from typing import Any, Literal, Self, get_args, get_origin, get_type_hints

from dppo.settings import (
    KlConfig,
    NetworkConfig,
    ReturnsConfig,
    RolloutConfig,
    SafetyConfig,
    UpdateConfig,
    require,
)

__all__ = [
    "Config",
    "KlConfig",
    "NetworkConfig",
    "ReturnsConfig",
    "RolloutConfig",
    "RunConfig",
    "SafetyConfig",
    "UpdateConfig",
]


def require_seed(seed: int) -> None:
    """Raise a ValueError in the words of the command line unless random streams take the seed."""
    require(0 <= seed < 2**63, "seed", seed, "0 <= seed < 2**63")


@dataclass(frozen=True, slots=True, kw_only=True)
class RunConfig:
    """What is trained, on what, for how long."""

    env: str = "Ant-v4"
    """Gymnasium environment id (--env-id works too)."""
    env_kwargs: str = "{}"
    """Keyword arguments of the environment, as JSON, e.g. '{"ctrl_cost_weight": 0.1}'."""
    seed: int = 0
    """Seed of every random stream; same seed and settings, same bits."""
    total_timesteps: int = 1_000_000
    """Environment steps of all slots together; accepts 1e6; rounded up to whole iterations."""

    def __post_init__(self) -> None:
        """Refuse what cannot be run."""
        require_seed(self.seed)
        require(self.total_timesteps >= 1, "total_timesteps", self.total_timesteps, ">= 1")
        try:
            is_object = isinstance(json.loads(self.env_kwargs), dict)
        except json.JSONDecodeError:
            is_object = False
        require(is_object, "env_kwargs", repr(self.env_kwargs), 'a JSON object such as {"a": 1}')


@dataclass(frozen=True, slots=True, kw_only=True)
class Config:
    """One run. Equal configs and seeds give equal parameters, bit for bit (with drop 0)."""

    run: RunConfig = field(default_factory=RunConfig)
    rollout: RolloutConfig = field(default_factory=RolloutConfig)
    returns: ReturnsConfig = field(default_factory=ReturnsConfig)
    safety: SafetyConfig = field(default_factory=SafetyConfig)
    update: UpdateConfig = field(default_factory=UpdateConfig)
    kl: KlConfig = field(default_factory=KlConfig)
    network: NetworkConfig = field(default_factory=NetworkConfig)

    def __post_init__(self) -> None:
        """Refuse what only shows across groups."""
        samples = self.rollout.samples_per_slot
        for name, slices in (
            ("num_minibatches", self.update.num_minibatches),
            ("critic_minibatches", self.update.critic_slices),
        ):
            require(
                samples % slices == 0,
                name,
                slices,
                f"a divisor of the {samples} samples of a slot (num_envs x num_steps)",
            )

    @property
    def iterations(self) -> int:
        """N: iterations of the run, total_timesteps rounded up."""
        return -(-self.run.total_timesteps // self.rollout.samples)

    def env_steps(self, iterations: int) -> int:
        """Environment steps of so many iterations."""
        return iterations * self.rollout.samples

    def to_dict(self) -> dict[str, dict[str, Any]]:
        """Nested plain values, for JSON. Infinity becomes the string "inf"."""
        return {
            group: {name: _plain(value) for name, value in fields.items()}
            for group, fields in dataclasses.asdict(self).items()
        }

    def differences(self, before: "Config") -> list[str]:
        """What is set otherwise than before, each as `--flag was 1, is 2`."""
        return [
            f"--{name.replace('_', '-')} was {was}, is {value}"
            for _, name, was, value in self.unequal(before.to_dict())
        ]

    def unequal(self, before: dict[str, Any]) -> list[tuple[str, str, Any, Any]]:
        """Group, name, value before and now, of settings that `to_dict` had otherwise before.

        What `before` lacks, of another version, is left out.
        """
        return [
            (group, name, before[group][name], value)
            for group, fields in self.to_dict().items()
            for name, value in fields.items()
            if name in before.get(group, {}) and before[group][name] != value
        ]

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> Self:
        """The inverse of `to_dict`; missing fields take their defaults.

        Raises:
            ValueError: a group, a field or a value that does not belong, named.
        """
        groups = {}
        known_groups = {group.name: group for group in dataclasses.fields(cls)}
        for name, fields in values.items():
            if name not in known_groups or not isinstance(fields, dict):
                raise ValueError(
                    f"found the group {name!r}, expected tables named {', '.join(known_groups)}"
                )
            group_type = type(getattr(cls(), name))
            groups[name] = group_type(**_fields(group_type, fields))
        return cls(**groups)


def _plain(value: Any) -> Any:  # noqa: ANN401  any field value, to any JSON value
    if isinstance(value, tuple):
        return list(value)
    return "inf" if value == math.inf else value


def _fields(group: type, values: dict[str, Any]) -> dict[str, Any]:
    """Field values of one group from JSON or TOML, checked by name, type and choice."""
    defaults = {f.name: getattr(group(), f.name) for f in dataclasses.fields(group)}
    hints = get_type_hints(group)
    checked = {}
    for name, value in values.items():
        if name not in defaults:
            raise ValueError(f"found the setting {name!r}, expected one of {', '.join(defaults)}")
        checked[name] = _coerced(name, value, defaults[name])
        choices = get_args(hints[name]) if get_origin(hints[name]) is Literal else ()
        if choices and value not in choices:
            raise ValueError(f"{name} is {value!r}, expected one of {', '.join(choices)}")
    return checked


def _coerced(name: str, value: Any, default: Any) -> Any:  # noqa: ANN401  see _plain
    match default, value:
        case tuple(), list() if all(type(item) is int for item in value):
            return tuple(value)
        case float(), "inf":
            return math.inf
        case float(), int() | float() if type(value) is not bool and abs(value) < 1e300:
            return float(value)
        case float(), float():
            return value  # infinite or not a number: the group's own checks judge it
        case int(), float() if type(default) is int and value.is_integer():
            return int(value)
        case _ if type(value) is type(default):
            return value
    raise ValueError(
        f"{name} is {value!r}, expected a {type(default).__name__} such as {default!r}"
    )
