"""A grid from a TOML file. `docs/experiments.md` has an example and every word."""

import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from dppo.errors import UsageError
from dppo.experiment.plan import Grid, Run, whole_number
from dppo.experiment.settings import flag, plain

_WORDS = ("title", "environments", "seeds", "steps", "evaluate", "baseline", "settings", "arms")
_NEEDED = ("environments", "seeds", "steps", "arms")


def read_grid(path: Path) -> Grid:
    """The grid that a file describes.

    Raises:
        UsageError: the file cannot be read, or is no grid; says what was found.
    """
    try:
        values = tomllib.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise UsageError(
            f"{path} is not a readable TOML file: {error}; expected a grid, or "
            "table2, report or keep"
        ) from error
    try:
        return _grid(values, path.stem)
    except (UsageError, ValueError) as error:
        raise UsageError(f"{path}: {error}") from error


def _grid(values: Mapping[str, Any], stem: str) -> Grid:
    for word in values:
        if word not in _WORDS:
            raise UsageError(f"found {word!r}, expected {', '.join(_WORDS)}")
    for word in _NEEDED:
        if word not in values:
            raise UsageError(f"found no {word}, expected {', '.join(_NEEDED)}")
    common = _settings(values.get("settings", {}), "settings")
    envs = _texts(values, "environments")
    arms = _table(values["arms"], "arms")
    if not arms:
        raise UsageError("arms is empty, expected tables such as [arms.safe]")
    steps = whole_number("steps", _number(values, "steps"), 1)
    runs = [
        Run.build(env=env, arm=arm, seed=seed, steps=steps, settings={**common, **settings})
        for arm, words in arms.items()
        for env, settings in _on_each(arm, _table(words, f"arms.{arm}"), envs)
        for seed in _seeds(values["seeds"])
    ]
    baseline = values.get("baseline", _plain_arm(runs))
    if not isinstance(baseline, str) or baseline not in arms:
        raise UsageError(f"baseline is {baseline!r}, expected an arm: {', '.join(arms)}")
    return Grid(
        title=_text(values, "title", stem),
        runs=tuple(runs),
        baseline=baseline,
        evaluate=whole_number("evaluate", _number(values, "evaluate", 100), 0),
    )


def _on_each(
    arm: str, words: Mapping[str, Any], envs: list[str]
) -> Iterator[tuple[str, dict[str, Any]]]:
    """The arm's settings on every environment: a table of its name overrides the rest."""
    special = {
        name: value
        for name, value in words.items()
        if isinstance(value, dict) and name.replace("-", "_") != "env_kwargs"
    }
    for name in special:
        if name not in envs:
            raise UsageError(
                f"arms.{arm} has a table {name!r}, expected one of the environments: "
                f"{', '.join(envs)}"
            )
    rest = {name: value for name, value in words.items() if name not in special}
    for env in envs:
        own = _settings(special.get(env, {}), f"arms.{arm}.{env}")
        yield env, {**_settings(rest, f"arms.{arm}"), **own}


def _settings(values: object, where: str) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, value in _table(values, where).items():
        key = name.replace("-", "_")
        if key in found:
            raise UsageError(f"{where} has {flag(key)} twice, with - and with _; give it once")
        found[key] = plain(key, value)
    return found


def _table(value: object, where: str) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise UsageError(f"{where} is {value!r}, expected a table")
    return value


def _texts(values: Mapping[str, Any], name: str) -> list[str]:
    found = values[name]
    if not isinstance(found, list) or not found or not all(isinstance(one, str) for one in found):
        raise UsageError(f'{name} is {found!r}, expected a list such as ["Hopper-v4"]')
    return found


def _text(values: Mapping[str, Any], name: str, default: str) -> str:
    found = values.get(name, default)
    if not isinstance(found, str):
        raise UsageError(f"{name} is {found!r}, expected a text")
    return found


def _number(values: Mapping[str, Any], name: str, default: int = 0) -> float:
    found = values.get(name, default)
    if isinstance(found, bool) or not isinstance(found, int | float):
        raise UsageError(f"{name} is {found!r}, expected a number")
    return float(found)


def _seeds(value: object) -> list[int]:
    """5 means 1 to 5; a list means its own."""
    if type(value) is int and value >= 1:
        return list(range(1, value + 1))
    if isinstance(value, list) and value and all(type(one) is int and one >= 0 for one in value):
        return value
    raise UsageError(f"seeds is {value!r}, expected a count >= 1 or a list of seeds >= 0")


def _plain_arm(runs: list[Run]) -> str:
    """The first arm without a penalty, or the first."""
    return next((run.arm for run in runs if run.is_plain), runs[0].arm)
