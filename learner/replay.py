"""A run that is run again by its ledger: whom each update asks, and whether the bits are the same.

The chief asks only the slots that the original went on with. Whoever holds them computes the same
gradients, and they are added along the same tree, so every hash has to be the same.
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dppo.config import Config
from dppo.errors import RunFailedError, UsageError
from dppo.store.ledger import IterationLine, Line, UpdateLine, read_ledger
from dppo.store.run_directory import RunDirectory


@dataclass(frozen=True, slots=True)
class Original:
    """What the ledger of a run says."""

    run: Path
    slots_of_run: int
    facts: dict[str, Any]
    """Its config.json."""
    updates: dict[tuple[int, int], UpdateLine]
    """(iteration, update) to its line; empty for a run with --drop 0."""
    iterations: list[IterationLine]

    @classmethod
    def read(cls, run: Path, config: Config) -> "Original":
        """The finished iterations in a run's ledger.

        Raises:
            UsageError: it cannot be read, has no finished iteration, or has a gap; which.
        """
        try:
            facts = json.loads((run / "config.json").read_text())
        except (OSError, ValueError) as error:
            raise UsageError(
                f"{run} holds no run to replay: {error}; expected a run directory of dppo-learner"
            ) from error
        file = run / "ledger.jsonl"
        updates, iterations = {}, []
        for line in read_ledger(file):
            match line:
                case UpdateLine():
                    updates[line.iteration, line.update] = line
                case IterationLine():
                    iterations.append(line)
        original = cls(run, config.rollout.slots, facts, updates, iterations)
        if complaint := original._complaint(config):
            raise UsageError(f"{file} cannot be replayed: {complaint}")
        return original

    def _complaint(self, config: Config) -> str:
        """Why the ledger cannot be followed, in words; empty if it can."""
        if not self.iterations:
            return "it has no finished iteration yet"
        for expected, line in enumerate(self.iterations):
            if line.iteration != expected:
                return f"found the line of iteration {line.iteration}, expected {expected}"
        if len(self.iterations) > config.iterations:
            return f"found {len(self.iterations)} iterations, expected {config.iterations} at most"
        if config.rollout.drop > 0:
            for iteration in range(1, len(self.iterations)):
                for update in range(config.update.updates):
                    if complaint := self._complaint_about(iteration, update, config):
                        return f"iteration {iteration}, update {update} {complaint}"
        return ""

    def _complaint_about(self, iteration: int, update: int, config: Config) -> str:
        """The same of one update."""
        line, settings = self.updates.get((iteration, update)), config.rollout
        if line is None:
            return "has no line"
        dropped = set(line.dropped)
        distinct = len(dropped) == len(line.dropped)
        if distinct and len(dropped) <= settings.drop and max(dropped, default=0) < settings.slots:
            return ""
        return (
            f"went on without slots {list(line.dropped)}, expected at most {settings.drop} "
            f"of 0 to {settings.slots - 1}"
        )

    @property
    def run_id(self) -> str:
        """The run's random id; empty if an early version made it."""
        try:
            return (self.run / "run-id").read_text()
        except OSError:
            return ""

    def check_folder(self, folder: RunDirectory) -> None:
        """A replay begins in a new folder, or goes on in its own.

        Raises:
            UsageError: the folder holds another run, or the whole replay.
        """
        if not (folder.path / "config.json").exists():
            return
        if folder.read_json("config.json").get("replay_of") != self.run_id:
            raise UsageError(
                f"{folder.path} holds a run that is no replay of {self.run}; give another folder"
            )
        if folder.is_finished:
            raise UsageError(
                f"{folder.path} holds a finished replay of {self.run}; remove it to begin anew, "
                "or give another folder"
            )

    def slots(self, iteration: int, update: int) -> tuple[int, ...]:
        """Whom the original's update went on with."""
        line = self.updates.get((iteration, update))
        dropped = () if line is None else line.dropped
        return tuple(slot for slot in range(self.slots_of_run) if slot not in dropped)

    def compare(self, line: Line) -> None:
        """A line of the replay with the original's, if that has come so far.

        Raises:
            RunFailedError: it is the first one with other parameters.
        """
        if line.iteration >= len(self.iterations):
            return  # the original has been resumed since, from an earlier checkpoint
        match line:
            case UpdateLine():
                where = f"iteration {line.iteration}, update {line.update}"
                here, there = line.parameters, self.updates[line.iteration, line.update].parameters
            case IterationLine():
                where = f"iteration {line.iteration}"
                here = line.parameters_sha256
                there = self.iterations[line.iteration].parameters_sha256
            case _:
                return
        if here != there:
            raise RunFailedError(
                f"{where} is the first that differs from {self.run}: parameters {here[:16]} here, "
                f"{there[:16]} in its ledger; if versions and kind of machine are those in "
                "config.json, the ledger was altered, or the run was not exact"
            )

    @property
    def verdict(self) -> str:
        """What to say when nothing has differed."""
        counted = len([1 for iteration, _ in self.updates if iteration < len(self.iterations)])
        return (
            f"same bits as {self.run}: {len(self.iterations)} iterations"
            + (f", {counted} updates" if counted else "")
            + f", parameters_sha256 {self.iterations[-1].parameters_sha256}"
        )
