"""The folder of an experiment: what was planned, where runs lie, what they have left.

plan.json       every run that was ever planned here, and how the experiment was started
failures.json   runs that have failed, with the reason
runs/<name>/    the run directories of dppo-learner, each with an evaluation.json
logs/<name>.txt what the learner and the evaluation have printed
results.json, curves.csv, report.md, report.html, *.png: see results.py and report.py
"""

import json
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dppo.errors import UsageError
from dppo.experiment.plan import Grid, Run
from dppo.files import replace_durably, take_lock
from dppo.store.checkpoint import prune
from dppo.store.reading import newest_row, read_object
from dppo.store.run_directory import read_config

_KEPT_SESSIONS = 100


@dataclass(frozen=True, slots=True)
class Plan:
    """What a folder's experiment consists of."""

    grid: Grid
    sessions: tuple[Mapping[str, Any], ...]
    """How it was started, each time."""


@dataclass(frozen=True, slots=True)
class Folder:
    """An experiment's folder."""

    path: Path

    def run(self, run: Run) -> Path:
        """Run directory of one run."""
        return self.path / "runs" / run.name

    def log(self, run: Run) -> Path:
        """What its processes have printed."""
        return self.path / "logs" / f"{run.name}.txt"

    def lock(self) -> int:
        """Make the folder and take its lock, which goes with this process however it ends.

        Raises:
            UsageError: it cannot be written, or another experiment is at work in it.
        """
        try:
            for name in ("runs", "logs"):
                (self.path / name).mkdir(parents=True, exist_ok=True)
            lock = take_lock(self.path / ".lock")
        except OSError as error:
            raise UsageError(
                f"--out {self.path} cannot be written: {error.strerror}; give a folder of yours"
            ) from error
        if lock is None:
            raise UsageError(
                f"another experiment is at work in --out {self.path}; stop it, or give another "
                "folder"
            )
        return lock

    def read_plan(self) -> Plan | None:
        """What was planned here so far; None: nothing.

        Raises:
            UsageError: the plan cannot be read.
        """
        file = self.path / "plan.json"
        if not file.exists():
            return None
        try:
            values = json.loads(file.read_text())
            runs = tuple(Run.from_dict(one) for one in values["runs"])
            grid = Grid(
                title=values["title"],
                runs=runs,
                baseline=values["baseline"],
                evaluate=values["evaluate"],
            )
            return Plan(grid, tuple(values["sessions"]))
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise UsageError(
                f"{file} is no plan of an experiment: {type(error).__name__} {error}; give "
                "another --out, or remove it if its runs are of no use"
            ) from error

    def add_to_plan(self, grid: Grid, session: Mapping[str, Any]) -> None:
        """Note a grid beside what was planned before, unless a run of it has other settings.

        Raises:
            UsageError: it has; every difference is listed.
        """
        before = self.read_plan()
        runs = {run.name: run for run in before.grid.runs} if before else {}
        for run in grid.runs:
            self._check(run, runs.get(run.name))
            runs[run.name] = run
        sessions = [*(before.sessions if before else ()), session][-_KEPT_SESSIONS:]
        values = {
            "title": grid.title,
            "baseline": grid.baseline,
            "evaluate": grid.evaluate,
            "runs": [run.to_dict() for run in runs.values()],
            "sessions": sessions,
        }
        self.write("plan.json", json.dumps(values, indent=1) + "\n")

    def trained_before(self, grid: Grid) -> tuple[Run, ...]:
        """Trained runs of earlier grids in this folder: they are in the report, too."""
        plan, names = self.read_plan(), {run.name for run in grid.runs}
        before = plan.grid.runs if plan else ()
        return tuple(run for run in before if run.name not in names and self.is_trained(run))

    def _check(self, run: Run, planned: Run | None) -> None:
        """The run is the one that was planned, and the one that was begun."""
        file = self.run(run) / "config.json"
        befores = [planned.config] if planned else []
        befores += [read_config(file)] if file.exists() else []
        for before in befores:
            if differences := run.config.differences(before):
                raise UsageError(
                    f"--out {self.path} holds the run {run.name} with other settings: "
                    f"{'; '.join(differences)}; use the same to continue it, or another --out"
                )

    def is_trained(self, run: Run) -> bool:
        """Its learner has reached the end."""
        return self.result(run).get("status") == "finished"

    def is_evaluated(self, run: Run, episodes: int) -> bool:
        """It is trained, and so many free episodes of its evaluation are there."""
        if not self.is_trained(run):
            return False
        found = self.evaluation(run).get("episodes", [])
        free = [one for one in found if one.get("start", "free") == "free"]
        return episodes == 0 or len(free) >= episodes

    def result(self, run: Run) -> dict[str, Any]:
        """How the run has ended; empty: it has not."""
        return read_object(self.run(run) / "result.json")

    def evaluation(self, run: Run) -> dict[str, Any]:
        """Its evaluation; empty: there is none."""
        return read_object(self.run(run) / "evaluation.json")

    def facts(self, run: Run) -> dict[str, Any]:
        """config.json: settings, versions; empty: it has not begun."""
        return read_object(self.run(run) / "config.json")

    def newest_row(self, run: Run) -> dict[str, Any]:
        """The last whole line of its metrics; empty: none yet."""
        return newest_row(self.run(run))

    def steps(self, run: Run) -> int:
        """Environment steps so far."""
        return int(self.newest_row(run).get("time/total_timesteps", 0))

    def is_in_use(self, run: Run) -> bool:
        """A learner is at work in the run directory: of an experiment that was killed just now."""
        folder = self.run(run)
        if not folder.is_dir():
            return False
        try:
            lock = take_lock(folder / ".lock")
        except OSError:
            return False  # the learner will say what is wrong with it
        if lock is None:
            return True
        os.close(lock)
        return False

    def thin_out(self, run: Run) -> None:
        """Keep what a finished run is needed for: its last checkpoint, and the best."""
        prune(self.run(run) / "checkpoints", 1)

    def failures(self) -> dict[str, str]:
        """Runs that have failed, with the reason."""
        return {name: str(why) for name, why in read_object(self.path / "failures.json").items()}

    def note_failures(self, failed: Mapping[str, str], runs: Iterable[Run]) -> None:
        """Failures of these runs replace what was noted of them before."""
        names = {run.name for run in runs}
        rest = {name: why for name, why in self.failures().items() if name not in names}
        if rest or failed or (self.path / "failures.json").exists():
            self.write("failures.json", json.dumps(rest | dict(failed), indent=1) + "\n")

    def write(self, name: str, text: str) -> None:
        """Replace a file of the experiment, all or nothing."""
        replace_durably(self.path / name, text.encode())
