"""The lines of `ledger.jsonl`: what each update went on without, and hashes to compare by.

    {"iteration": 3, "parameters_sha256": ...}                        each iteration
    {"iteration": 3, "update": 5, "dropped": [4], "waited": 0.01, "parameters": ...}   with --drop
    {"iteration": 3, "update": 5, "late": 4, "by": 0.2}               with --drop, when it came

Iterations and updates count from 0, as in messages. With --drop, an iteration's line also holds
`returns` and `lengths`: of each slot the mean over the episodes that ended in it, or null.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dppo.errors import UsageError


@dataclass(frozen=True, slots=True, kw_only=True)
class UpdateLine:
    """An update, with what it went on without."""

    iteration: int
    update: int
    dropped: tuple[int, ...]
    waited: float
    """From the question until the round closed [s]."""
    parameters: str
    """First 16 digits of the hash of the parameters after it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LateLine:
    """A gradient that came after its update."""

    iteration: int
    update: int
    late: int
    """The slot."""
    by: float
    """How long after [s]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class IterationLine:
    """A finished iteration."""

    iteration: int
    parameters_sha256: str
    returns: tuple[float | None, ...] = ()
    """Of each slot, the mean return of the episodes that ended; empty with --drop 0."""
    lengths: tuple[float | None, ...] = ()
    """Of each slot, their mean length [env steps]."""


Line = UpdateLine | LateLine | IterationLine


def to_json(line: Line) -> str:
    """One line, without its end."""
    values = {name: getattr(line, name) for name in line.__slots__}
    if isinstance(line, IterationLine) and not line.returns:
        del values["returns"], values["lengths"]
    return json.dumps(values)


def from_json(text: str) -> Line:
    """The inverse of `to_json`.

    Raises:
        ValueError: it is no such line.
    """
    return from_values(json.loads(text))


def from_values(values: Any) -> Line:  # noqa: ANN401  any JSON value
    """A line from what its JSON holds.

    Raises:
        ValueError: it is no such line.
    """
    if not isinstance(values, dict):
        raise ValueError(f"found a {type(values).__name__}, expected an object")
    kind: type[Line] = IterationLine
    if "update" in values:
        kind = LateLine if "late" in values else UpdateLine
    fields = {name: _READ[name](value) for name, value in values.items() if name in _READ}
    unknown = sorted(set(values) - set(_READ))
    try:
        if unknown:
            raise TypeError(f"{unknown[0]} belongs to no line")
        return kind(**fields)
    except TypeError as error:
        raise ValueError(f"found {str(values)[:80]!r}: {error}") from error


def read_ledger(file: Path) -> list[Line]:
    """All whole lines; a torn last one, of a learner that was killed, is left out.

    Raises:
        UsageError: there is no such file, or it has a line that is none; which one.
    """
    try:
        texts = file.read_text().splitlines(keepends=True)
    except (OSError, ValueError) as error:
        raise UsageError(f"{file} is not a readable ledger: {error}") from error
    lines = []
    for number, text in enumerate(texts, start=1):
        if not text.endswith("\n"):
            break
        try:
            lines.append(from_json(text))
        except ValueError as error:
            raise UsageError(f"{file}, line {number} is no line of a ledger: {error}") from error
    return lines


def _count(value: Any) -> int:  # noqa: ANN401  any JSON value
    if type(value) is not int or value < 0:
        raise ValueError(f"found {value!r}, expected a whole number from 0")
    return value


def _seconds(value: Any) -> float:  # noqa: ANN401  any JSON value
    if type(value) not in (int, float):
        raise ValueError(f"found {value!r}, expected seconds")
    return float(value)


def _hash(value: Any) -> str:  # noqa: ANN401  any JSON value
    if not isinstance(value, str):
        raise ValueError(f"found {value!r}, expected a hash")
    return value


def _slots(value: Any) -> tuple[int, ...]:  # noqa: ANN401  any JSON value
    if not isinstance(value, list):
        raise ValueError(f"found {value!r}, expected a list of slots")
    return tuple(map(_count, value))


def _means(value: Any) -> tuple[float | None, ...]:  # noqa: ANN401  any JSON value
    if not isinstance(value, list) or not all(
        each is None or type(each) in (int, float) for each in value
    ):
        raise ValueError(f"found {value!r}, expected a number or null of each slot")
    return tuple(value)


_READ: dict[str, Callable[[Any], Any]] = {
    "iteration": _count,
    "update": _count,
    "late": _count,
    "by": _seconds,
    "waited": _seconds,
    "dropped": _slots,
    "parameters": _hash,
    "parameters_sha256": _hash,
    "returns": _means,
    "lengths": _means,
}
