"""`dppo experiment`: a grid of runs from the first to the report."""

import inspect
import platform
import shlex
import sys
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

from dppo.arguments import ExperimentFolder, GridFile
from dppo.errors import UsageError
from dppo.experiment.folder import Folder, Plan
from dppo.experiment.plan import Grid, whole_number
from dppo.experiment.table2 import ENVIRONMENTS, table2
from dppo.machine import usable_cores
from dppo.settings import require

_USAGE = (
    "usage: dppo experiment table2 [options] [-- flags of dppo-learner], dppo experiment "
    "GRID.toml [options], dppo experiment report DIR, or dppo experiment keep DIR --out NEW; "
    "--help after one of these says more"
)


@dataclass(frozen=True, kw_only=True)
class GridArgs:
    """How a grid is run; started again in the same folder it goes on where it stood.

    One learner and one worker a run, several runs side by side. Exit code 0: all is done, or it
    was stopped by a signal; 1: a run has failed, see the report; 2: wrong usage.
    """

    jobs: int = 0
    """Runs side by side; 0: one per core this process may use [count]."""
    out: str = ""
    """Folder; empty: runs/ and the grid's name, a file's without .toml."""

    def __post_init__(self) -> None:
        """Refuse what cannot be run."""
        require(self.jobs >= 0, "jobs", self.jobs, ">= 0")


@dataclass(frozen=True, kw_only=True)
class Table2Args(GridArgs):
    """The paper's Table 2 and figures 6 to 9: psi 0, the paper's, and twice that.

    Flags after -- go to every learner, e.g. -- --preset paper. Started again in the same folder
    it goes on where it stood. Exit code 0: all is done, or it was stopped by a signal; 1: a run
    has failed, see the report; 2: wrong usage.
    """

    envs: tuple[str, ...] = ENVIRONMENTS
    """Gymnasium environment ids."""
    psis: tuple[float, ...] = ()
    """Penalties on every environment; none: 0, the paper's of each, and twice that."""
    seeds: int = 5
    """Seeds 1 to so many [count]."""
    steps: float = 3e6
    """Environment steps of each run [env steps]."""
    evaluate: float = 100
    """Evaluation episodes of each run from free starts, and again from a fixed one [count]."""

    def __post_init__(self) -> None:
        """Refuse what cannot be run."""
        GridArgs.__post_init__(self)
        require(self.seeds >= 1, "seeds", self.seeds, ">= 1")
        require(len(self.envs) >= 1, "envs", "empty", "one or more")
        require(not self.psis or 0.0 in self.psis, "psis", self.psis, "0 among them, to compare")
        whole_number("steps", self.steps, 1)
        whole_number("evaluate", self.evaluate, 0)


@dataclass(frozen=True, kw_only=True)
class FileArgs(GridArgs):
    """The grid of a TOML file; docs/experiments.md has an example.

    Started again in the same folder it goes on where it stood. Exit code 0: all is done, or it
    was stopped by a signal; 1: a run has failed, see the report; 2: wrong usage.
    """

    grid: GridFile
    """TOML file."""


@dataclass(frozen=True, kw_only=True)
class KeepArgs:
    """Copy what the report of an experiment needs, and each arm's best policy: a small folder.

    It can be kept with code or a paper: it gives the same report, and a copy of it goes on with
    more seeds.
    """

    folder: ExperimentFolder
    """Folder of the experiment; it may be running."""
    out: str
    """New folder."""


@dataclass(frozen=True, kw_only=True)
class ReportArgs:
    """Write the report of what an experiment has reached; trains nothing."""

    folder: ExperimentFolder
    """Folder of the experiment; it may be running."""


def run(words: list[str]) -> int:
    """`dppo experiment ...`; the exit code.

    Raises:
        UsageError: no grid that can be run.
    """
    from dppo.process import parse

    at = words.index("--") if "--" in words else len(words)
    own, theirs = words[:at], words[at + 1 :]
    if own[:1] != ["table2"] and theirs:
        raise UsageError(f"found {' '.join(theirs)} after --; only table2 takes learner flags")
    match own:
        case ["report", *rest]:
            return _report(parse(ReportArgs, rest, "dppo experiment report"))
        case ["keep", *rest]:
            return _keep(parse(KeepArgs, rest, "dppo experiment keep"))
        case ["table2", *rest]:
            args = parse(Table2Args, rest, "dppo experiment table2")
            return _experiment(_table2(args, theirs), args, "table2")
        case [file, *_] if not file.startswith("-"):
            args_of_file = parse(FileArgs, own, "dppo experiment")
            from dppo.experiment.grid_file import read_grid

            grid = read_grid(Path(args_of_file.grid))
            return _experiment(grid, args_of_file, Path(file).stem)
        case ["-h" | "--help", *_]:
            print(f"{_USAGE}\n\n{inspect.cleandoc(GridArgs.__doc__ or '')}")
            return 0
    raise UsageError(f"found {own[0] if own else 'nothing'}, expected a grid\n{_USAGE}")


def _table2(args: Table2Args, theirs: list[str]) -> Grid:
    from dppo.experiment.settings import from_words

    return table2(
        envs=args.envs,
        psis=args.psis,
        seeds=args.seeds,
        steps=int(args.steps),
        evaluate=int(args.evaluate),
        settings=from_words(theirs),
    )


def _experiment(grid: Grid, args: GridArgs, name: str) -> int:
    from dppo.experiment.console import Console
    from dppo.experiment.processes import check_environments
    from dppo.experiment.significance import has_tests
    from dppo.experiment.work import Work

    folder, jobs = Folder(Path(args.out or f"runs/{name}")), args.jobs or usable_cores()
    check_environments(run for run in grid.runs if not folder.is_trained(run))
    folder.lock()
    folder.add_to_plan(grid, _session(jobs))
    every = replace(grid, runs=(*grid.runs, *folder.trained_before(grid)))
    print(
        f"{len(grid.runs)} runs of {grid.steps / len(grid.runs):,.0f} steps, {jobs} side by side, "
        f"in {folder.path}; the same command goes on where it stops",
        flush=True,
    )
    if not has_tests():
        print(
            "the report will lack its tests and most intervals: SciPy is missing; pip install "
            "'.[experiment]'"
        )
    with Console() as console:
        work = Work(folder, every, jobs, console)
        is_over = work.run()
    failed = work.schedule.failed
    for run_name, reason in failed.items():
        print(f"failed: {run_name}: {reason}", file=sys.stderr)
    if not is_over:
        print(f"stopped; {work.schedule.done} of {len(every.runs)} runs are finished", flush=True)
        return 0
    if work.report_problem:
        print(f"error: the report cannot be written: {work.report_problem}", file=sys.stderr)
        return 1
    print(f"report: {folder.path / 'report.md'}", flush=True)
    return 1 if failed else 0


def _session(jobs: int) -> dict[str, object]:
    """How and where the experiment is started."""
    return {
        "command": shlex.join(["dppo", *sys.argv[1:]]),
        "time": datetime.now(UTC).isoformat(timespec="seconds"),
        "jobs": jobs,
        "cores": usable_cores(),
        "machine": platform.machine(),
        "processor": _processor(),
        "system": platform.platform(),
    }


def _processor() -> str:
    """The model's name, as the kernel has it."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor()


def _report(args: ReportArgs) -> int:
    from dppo.experiment.report import write_report

    print(f"see {write_report(*_planned(args.folder))}")
    return 0


def _keep(args: KeepArgs) -> int:
    from dppo.experiment.keep import keep

    print(f"see {keep(*_planned(args.folder), Path(args.out))}")
    return 0


def _planned(path: str) -> tuple[Folder, Plan]:
    folder = Folder(Path(path))
    plan = folder.read_plan()
    if plan is None:
        raise UsageError(f"{folder.path} holds no plan.json; expected a folder of dppo experiment")
    return folder, plan
