"""What the report of an experiment needs of its folder: small enough to go with code or a paper.

    plan.json, failures.json, results.json, curves.csv, report.md, report.html, *.png
    runs/<name>/    of a finished run: config.json, result.json, evaluation.json, its learning
                    curve as metrics.jsonl, its last training episodes as episodes.jsonl, and of
                    each arm's best seed, and of one that is still to be evaluated, the newest
                    checkpoint

It is a folder of an experiment itself: `dppo experiment report` gives the same report from it, and
a copy of it goes on with more seeds where it stands.
"""

import json
import shutil
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from dppo.errors import UsageError
from dppo.experiment.best import best_of
from dppo.experiment.compare import LAST
from dppo.experiment.folder import Folder, Plan
from dppo.experiment.measure import cells, curve_rows, json_lines
from dppo.experiment.plan import Run
from dppo.experiment.report import write_report
from dppo.store.checkpoint import names

_OF_THE_GRID = ("plan.json", "failures.json")
_OF_A_RUN = ("config.json", "result.json", "evaluation.json")


def keep(folder: Folder, plan: Plan, out: Path) -> Path:
    """Make a new folder of what the report needs, and the report in it; the page's path.

    What is interrupted leaves an empty folder.

    Raises:
        UsageError: the new folder cannot be made, or holds something.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
        if any(out.iterdir()):
            raise UsageError(f"--out {out} is not empty; expected a new folder, or an empty one")
        try:
            return _fill(Folder(out), folder, plan)
        except BaseException:  # a signal, too
            _empty(out)
            raise
    except OSError as error:
        raise UsageError(f"--out {out} cannot be written: {error}") from error


def _fill(kept: Folder, folder: Folder, plan: Plan) -> Path:
    best = {one.run.name for cell in cells(folder, plan.grid) if (one := best_of(cell))}
    _copy(folder.path, kept.path, _OF_THE_GRID)
    for run in filter(folder.is_trained, plan.grid.runs):
        _keep_run(run, folder.run(run), kept.run(run))
        if run.name in best or not folder.is_evaluated(run, plan.grid.evaluate):
            _keep_policy(folder.run(run) / "checkpoints", kept.run(run) / "checkpoints")
    return write_report(kept, plan)


def _empty(folder: Path) -> None:
    for path in folder.iterdir():
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)


def _keep_run(run: Run, path: Path, kept: Path) -> None:
    kept.mkdir(parents=True)
    _copy(path, kept, _OF_A_RUN)
    _write(kept / "metrics.jsonl", curve_rows(path, run))
    _write(kept / "episodes.jsonl", _last_episodes(path / "episodes.jsonl"))


def _last_episodes(file: Path) -> Iterator[dict[str, Any]]:
    """The last lines, of as many episodes as the report asks for."""
    rows = list(json_lines(file))
    first, found = len(rows), 0
    while first and found < max(LAST):
        first -= 1
        found += len(rows[first]["returns"])
    yield from rows[first:]


def _keep_policy(checkpoints: Path, kept: Path) -> None:
    for name in names(checkpoints)[-1:]:
        shutil.copytree(checkpoints / name, kept / name)


def _copy(source: Path, target: Path, files: Iterable[str]) -> None:
    for name in files:
        if (source / name).exists():
            shutil.copyfile(source / name, target / name)


def _write(file: Path, rows: Iterable[dict[str, Any]]) -> None:
    file.write_text("".join(json.dumps(row) + "\n" for row in rows))
