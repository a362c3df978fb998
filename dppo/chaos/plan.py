"""A plan of faults: what happens, at which iteration, to whom; a file, or drawn from a seed."""

import json
import math
import random
import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from dppo.errors import UsageError

LINK_KINDS = (
    "disconnect", "partition", "partition-to-learner", "partition-to-worker", "delay", "slow",
    "loss", "corrupt-to-learner", "corrupt-to-worker",
)  # fmt: skip
"""On the link between an external worker and the learner."""
LEARNER_KINDS = ("kill-learner", "stop-learner", "terminate-learner", "corrupt-checkpoint")
WORKER_KINDS = ("kill-worker", "stop-worker", "leave-worker", "join-worker")
KINDS = (*WORKER_KINDS, *LEARNER_KINDS, *LINK_KINDS)
AT_ONCE = (
    "kill-worker", "leave-worker", "kill-learner", "terminate-learner", "corrupt-checkpoint",
    "disconnect",
)  # fmt: skip
"""They have no length: `seconds` is 0."""
ENDLESS = ("stop-worker", "join-worker")
"""`seconds` 0 means: until the end of the run."""
_TARGETS = {
    **dict.fromkeys(LINK_KINDS, r"w\d+"),
    **dict.fromkeys(LEARNER_KINDS, "learner"),
    "kill-worker": r"(w|local-)\d+",
    "stop-worker": r"(w|local-)\d+",
    "leave-worker": r"w\d+",
    "join-worker": r"x\d+",
}
_WORDS = {"w": "w0", "l": "learner", "x": "x0", "(": "w0 or local-0"}
_LENGTHS = (0.5, 3.0)
"""Shortest and longest fault that is drawn [s]."""


@dataclass(frozen=True, slots=True)
class Fault:
    """One thing that goes wrong."""

    at: int
    """It happens when the run has logged this iteration."""
    fault: str
    """One of `KINDS`."""
    target: str
    """learner; w0, ...: an external worker or its link; local-0, ...; x0, ...: a new worker."""
    seconds: float = 0.0
    """How long it lasts; 0: an instant, or for `ENDLESS` kinds the rest of the run."""

    def __post_init__(self) -> None:
        """Refuse what makes no sense, in a sentence."""
        if self.at < 1:
            raise ValueError(f"at is {self.at}, expected an iteration >= 1")
        if self.fault not in KINDS:
            raise ValueError(f"fault is {self.fault!r}, expected one of {', '.join(KINDS)}")
        pattern = _TARGETS[self.fault]
        if not re.fullmatch(pattern, self.target):
            raise ValueError(
                f"target of {self.fault} is {self.target!r}, expected a name such as "
                f"{_WORDS[pattern[0]]}"
            )
        if not (math.isfinite(self.seconds) and self.seconds >= 0):
            raise ValueError(f"seconds is {self.seconds}, expected a finite number >= 0")
        if self.fault in AT_ONCE and self.seconds:
            raise ValueError(f"{self.fault} happens in an instant: leave seconds out")
        if self.fault not in (*AT_ONCE, *ENDLESS) and not self.seconds:
            raise ValueError(f"{self.fault} needs seconds > 0: how long it lasts")


@dataclass(frozen=True, slots=True)
class Plan:
    """All faults of one run, in the order in which they happen."""

    faults: tuple[Fault, ...]

    def __post_init__(self) -> None:
        """Sort them; those of one iteration stay as they were."""
        object.__setattr__(self, "faults", tuple(sorted(self.faults, key=lambda one: one.at)))

    @classmethod
    def seeded(
        cls,
        seed: int,
        *,
        faults: int,
        iterations: int,
        workers: int,
        local_workers: int = 1,
        kinds: Sequence[str] = KINDS,
    ) -> "Plan":
        """As many faults as asked for, spread over the run; the same ones for the same arguments.

        Each kind comes once before any comes twice. The last tenth of the run stays free, so that
        the last faults have something to disturb.
        """
        if iterations < 10:
            raise ValueError(
                f"a run of {iterations} iterations is too short, expected at least 10"
            )
        dice = random.Random(seed)
        possible = [kind for kind in kinds if workers or kind not in (*LINK_KINDS, "leave-worker")]
        if not workers and not local_workers:
            raise ValueError("there is no worker to disturb: give workers or local workers")
        drawn: list[str] = []
        while len(drawn) < faults:
            drawn += dice.sample(possible, len(possible))
        last = iterations - max(1, iterations // 10)
        places = sorted(dice.randint(2, last) for _ in range(faults))
        names = [f"w{index}" for index in range(workers)]
        everyone = names + [f"local-{index}" for index in range(local_workers)]
        return cls(
            tuple(
                _drawn(dice, at, kind, names, everyone)
                for at, kind in zip(places, drawn, strict=False)
            )
        )

    @classmethod
    def read(cls, path: Path) -> "Plan":
        """A plan from a JSON file.

        Raises:
            UsageError: it cannot be read, or holds something else; says where.
        """
        try:
            rows = json.loads(path.read_text())
        except (OSError, ValueError) as error:
            raise UsageError(f"--plan {path} is not a readable JSON file: {error}") from error
        if not isinstance(rows, list):
            raise UsageError(
                f"--plan {path} holds a {type(rows).__name__}, expected a list of faults such as "
                '{"at": 10, "fault": "kill-worker", "target": "w0"}'
            )
        faults = []
        for number, row in enumerate(rows):
            try:
                faults.append(_fault(row))
            except ValueError as error:
                raise UsageError(f"--plan {path}, fault {number}: {error}") from error
        return cls(tuple(faults))

    def to_json(self) -> str:
        """As `read` takes it, one fault per line."""
        lines = ",\n".join(f"  {json.dumps(asdict(fault))}" for fault in self.faults)
        return f"[\n{lines}\n]\n" if self.faults else "[]\n"

    def check(self, *, iterations: int, workers: int, local_workers: int) -> None:
        """Refuse a plan that a run cannot carry out.

        Raises:
            UsageError: a fault comes too late, or is for somebody who is not there.
        """
        for fault in self.faults:
            if fault.at >= iterations:
                raise UsageError(
                    f"{fault.fault} is planned for iteration {fault.at}, but the run ends with "
                    f"iteration {iterations}; plan it earlier, or raise --total-timesteps"
                )
            kind, _, number = fault.target.rpartition("-" if "-" in fault.target else "w")
            there = {"local": local_workers, "": workers}.get(kind)
            if number.isdigit() and there is not None and int(number) >= there:
                raise UsageError(
                    f"{fault.fault} is planned for {fault.target}, but there are {workers} "
                    f"external workers (w0 ...) and {local_workers} local ones (local-0 ...)"
                )
        stopped = {f.target for f in self.faults if f.fault == "stop-worker" and not f.seconds}
        if not local_workers and len(stopped) >= workers:
            raise UsageError(
                "the plan stops every worker for ever, so the run cannot end; give one of them "
                "seconds > 0, or --local-workers 1"
            )


def _fault(row: Any) -> Fault:  # noqa: ANN401  what JSON gives
    """One fault of a file."""
    if not isinstance(row, dict):
        raise ValueError(f"it is a {type(row).__name__}, expected an object")
    known: dict[str, type | tuple[type, ...]] = {
        "at": int, "fault": str, "target": str, "seconds": (int, float)
    }  # fmt: skip
    for name, value in row.items():
        if name not in known:
            raise ValueError(f"{name!r} is no field of a fault, expected {', '.join(known)}")
        if not isinstance(value, known[name]) or isinstance(value, bool):
            raise ValueError(f"{name} is {value!r}, of the wrong type")
    for name in ("at", "fault", "target"):
        if name not in row:
            raise ValueError(f"{name} is missing")
    return Fault(**row)


def _drawn(
    dice: random.Random, at: int, kind: str, names: list[str], everyone: list[str]
) -> Fault:
    """One fault of a kind, on whom and for how long as the dice fall.

    Whoever comes first is never stopped for ever, so somebody is always left to work.
    """
    if kind in LEARNER_KINDS:
        target = "learner"
    elif kind == "join-worker":
        target = f"x{dice.randrange(3)}"
    elif kind in ("kill-worker", "stop-worker"):
        target = dice.choice(everyone)
    else:
        target = dice.choice(names)
    seconds = 0.0 if kind in AT_ONCE else round(dice.uniform(*_LENGTHS), 2)
    if kind == "stop-worker" and target != everyone[0] and dice.random() < 0.25:
        seconds = 0.0
    return Fault(at, kind, target, seconds)
