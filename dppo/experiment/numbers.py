"""Numbers of results.json as the report prints them."""

from collections.abc import Mapping, Sequence
from typing import Any

NOTHING = "–"


def pair(mean: float, std: float | None) -> str:
    """Mean ± standard deviation; None: of one seed."""
    return f"{mean:.1f}" if std is None else f"{mean:.1f} ± {std:.1f}"


def ends(interval: Any, digits: int = 1) -> str:  # noqa: ANN401  JSON
    """An interval in brackets, behind a blank; empty: there is none."""
    if interval is None:
        return ""
    return f" [{interval[0]:.{digits}f}, {interval[1]:.{digits}f}]"


def with_ends(one: Mapping[str, Any], name: str) -> str:
    """A figure with its interval."""
    return f"{one[name]:.1f}{ends(one[f'{name}_interval'])}"


def times(against: Mapping[str, Any], name: str) -> str:
    """A ratio with its interval."""
    value = against.get(f"{name}_ratio")
    if value is None:
        return NOTHING
    bounds = against[f"{name}_ratio_interval"]
    return f"{value:.2f}" + (
        "" if bounds is None else f" [{_short(bounds[0])}, {_short(bounds[1])}]"
    )


def seed_range(by_seed: Sequence[float], form: str) -> str:
    """From which to which seed, or the only one."""
    low, high = (format(end(by_seed), form) for end in (min, max))
    return f"{low} to {high}" if len(by_seed) > 1 else low


def over_seeds(value: float, by_seed: Sequence[float], form: str) -> str:
    """A number over seeds, and from which to which seed it is."""
    seeds = f" (seeds: {seed_range(by_seed, form)})" if len(by_seed) > 1 else ""
    return format(value, form) + seeds


def ratio_of(one: Any) -> str:  # noqa: ANN401  JSON
    """A ratio over environments with its interval; None: there is none."""
    return NOTHING if one is None else f"{one['ratio']:.2f}{both_ends(one)}"


def both_ends(one: Mapping[str, Any]) -> str:
    """The two intervals of a ratio over environments; empty: there is none."""
    seeds = ends(one.get("interval_of_seeds"), 2)
    return ends(one["interval"], 2) + (f", by seeds{seeds}" if seeds else "")


def _short(value: float) -> str:
    return f"{value:.2f}" if value < 100 else f"{value:.3g}"


def p_value(value: float | None) -> str:
    """Two digits."""
    return NOTHING if value is None else f"{value:.2g}"
