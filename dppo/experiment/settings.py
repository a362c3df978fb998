"""An arm's settings: from a file or the command line, to a `Config` and to the learner's flags."""

import difflib
import json
from collections.abc import Mapping, Sequence
from typing import Any

from dppo.config import Config
from dppo.errors import UsageError
from dppo.presets import PRESETS

Settings = Mapping[str, Any]
"""Names of `Config`'s fields, or `preset`, to plain values."""
_OURS = {"env": "environments", "seed": "seeds", "total_timesteps": "steps"}
"""What the grid itself says."""


def resolved(env: str, seed: int, steps: int, settings: Settings) -> Config:
    """The whole configuration of a run.

    Raises:
        UsageError: a setting that does not exist, or a value that cannot be.
    """
    values = dict(settings)
    preset = values.pop("preset", "default")
    if not isinstance(preset, str) or preset not in PRESETS:
        raise UsageError(f"preset is {preset!r}, expected one of {', '.join(PRESETS)}")
    groups = PRESETS[preset](env).to_dict()
    place = {name: group for group, fields in groups.items() for name in fields}
    for name, value in values.items():
        check_name(name)
        groups[place[name]][name] = value
    groups["run"] |= {"env": env, "seed": seed, "total_timesteps": steps}
    try:
        return Config.from_dict(groups)
    except ValueError as error:
        raise UsageError(str(error)) from error


def check_name(name: str) -> None:
    """Refuse what is no setting of an arm.

    Raises:
        UsageError: says what is near to it.
    """
    if name in _OURS:
        raise UsageError(f"found the setting {flag(name)}; give it as {_OURS[name]} of the grid")
    known = ["preset", *_defaults()]
    if name not in known:
        near = difflib.get_close_matches(name, known, n=3) or ["psi", "preset"]
        raise UsageError(
            f"found the setting {flag(name)}, expected one of dppo-learner's that change the "
            f"result, such as {', '.join(map(flag, near))}"
        )


def plain(name: str, value: Any) -> Any:  # noqa: ANN401  any TOML or JSON value
    """A value of a file as `Config` takes it: a table of the environment's arguments is JSON.

    Raises:
        UsageError: it holds what JSON cannot.
    """
    if name != "env_kwargs" or not isinstance(value, dict):
        return value
    try:
        return json.dumps(value, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise UsageError(
            f"env-kwargs is {value!r}, expected what JSON can hold: {error}"
        ) from error


def flag(name: str) -> str:
    """`--adv-norm` for `adv_norm`."""
    return "--" + name.replace("_", "-")


def words_of(settings: Settings) -> list[str]:
    """The settings as flags of dppo-learner."""
    words: list[str] = []
    for name, value in settings.items():
        match value:
            case bool():
                words.append(flag(name) if value else flag(f"no_{name}"))
            case list() | tuple():
                words += [flag(name), *map(str, value)]
            case _:
                words += [flag(name), str(value)]
    return words


def from_words(words: Sequence[str]) -> dict[str, Any]:
    """The inverse: flags of dppo-learner as settings.

    Raises:
        UsageError: words that are no such flags.
    """
    found: dict[str, list[str]] = {}
    for word in words:
        if word.startswith("--"):
            name, equals, value = word[2:].partition("=")
            values = found[name.replace("-", "_")] = [value] if equals else []
        elif not found:
            raise UsageError(f"found {word!r} after --, expected a flag of dppo-learner first")
        else:
            values.append(word)
    return dict(_setting(name, values) for name, values in found.items())


def _setting(name: str, values: list[str]) -> tuple[str, Any]:
    defaults = _defaults()
    positive = name.removeprefix("no_")
    if isinstance(defaults.get(positive), bool) and not values:
        return positive, name == positive
    check_name(name)
    if isinstance(defaults.get(name), tuple):
        return name, [_number(value) for value in values]
    if len(values) != 1:
        raise UsageError(f"{flag(name)} has the values {values}, expected one")
    is_text = name == "preset" or isinstance(defaults.get(name), str)
    return name, values[0] if is_text else _number(values[0])


def _number(text: str) -> int | float | str:
    """A number, or the text for `Config` to judge."""
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text


def _defaults() -> dict[str, Any]:
    groups = Config()
    return {
        name: getattr(getattr(groups, group), name)
        for group, fields in groups.to_dict().items()
        for name in fields
    }
