"""What came of a drill: times, hashes, what the processes took and what they left behind."""

import statistics
from dataclasses import asdict, dataclass, field
from typing import Any

from dppo.chaos.plan import Fault
from dppo.chaos.processes import Usage

_WARM_UP_SECONDS = 60.0
"""Imports and first iterations are no leak."""
_LEAST_SECONDS = 120.0
"""A process that lived shorter after its warm-up says nothing about slopes."""


@dataclass(slots=True)
class FaultRecord:
    """One fault as it happened."""

    fault: Fault
    iteration: int
    """The highest one logged when it happened."""
    begun: float
    """When it happened [s since the start]."""
    said: str = ""
    """What became of it, if not what was planned."""
    recovered: float | None = None
    """How long it took until the next iteration was logged [s]; None: that never came."""


@dataclass(frozen=True, slots=True)
class Growth:
    """How a process that lived long enough has grown."""

    name: str
    seconds: float
    rss_mb: float
    """At its end."""
    rss_mb_per_hour: float
    fds_per_hour: float
    threads_per_hour: float


@dataclass(slots=True)
class Outcome:
    """A whole drill."""

    problem: str = ""
    """Why the run did not end as it should; empty: it did."""
    status: str = ""
    sha256: str = ""
    exact: bool = False
    iterations: int = 0
    steps: int = 0
    restarts: int = 0
    seconds: float = 0.0
    median: float = 0.0
    """Of an iteration [s]."""
    faults: list[FaultRecord] = field(default_factory=list)
    left_behind: list[str] = field(default_factory=list)
    growth: list[Growth] = field(default_factory=list)

    def to_dict(self) -> dict[str, Any]:
        """For JSON: one flat object per fault."""
        values = asdict(self)
        values["faults"] = [row.pop("fault") | row for row in values["faults"]]
        return values


class Series:
    """Samples of what processes take, by name and number."""

    def __init__(self) -> None:
        self._samples: dict[tuple[str, int], list[tuple[float, Usage]]] = {}

    def add(self, name: str, pid: int, now: float, usage: Usage) -> None:
        """One look at one process."""
        self._samples.setdefault((name, pid), []).append((now, usage))

    def growth(self) -> list[Growth]:
        """Slopes of all that lived long enough, by least squares."""
        return [
            _growth(f"{name} ({pid})", warm)
            for (name, pid), samples in sorted(self._samples.items())
            if (warm := [one for one in samples if one[0] - samples[0][0] >= _WARM_UP_SECONDS])
            and warm[-1][0] - warm[0][0] >= _LEAST_SECONDS
        ]


def _growth(name: str, samples: list[tuple[float, Usage]]) -> Growth:
    hours = [at / 3600 for at, _ in samples]

    def slope(values: list[float]) -> float:
        return statistics.linear_regression(hours, values).slope

    return Growth(
        name=name,
        seconds=samples[-1][0] - samples[0][0],
        rss_mb=samples[-1][1].rss / 1e6,
        rss_mb_per_hour=slope([usage.rss / 1e6 for _, usage in samples]),
        fds_per_hour=slope([float(usage.fds) for _, usage in samples]),
        threads_per_hour=slope([float(usage.threads) for _, usage in samples]),
    )
