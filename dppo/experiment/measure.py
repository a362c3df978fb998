"""What finished runs have left, as arrays."""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dppo.experiment.folder import Folder
from dppo.experiment.plan import Grid, Run
from dppo.experiment.statistics import Floats

_PLAIN_ARMS = ("psi-paper", "psi-twice")
"""Of Table 2: they differ in ψ alone."""
POINTS = 200
"""Of a learning curve."""
_CURVE = ("time/total_timesteps", "rollout/ep_rew_mean")
"""What it consists of, in metrics.jsonl."""
_MOVED = ("safety/psi", "safety/start_sigma")
"""What is of interest besides, where ψ moves."""
STARTS = ("free", "fixed")
"""Kinds of evaluation episodes."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Finished:
    """One finished run."""

    run: Run
    returns: Floats
    """[N] of the training episodes, at least of the last 200, in the order in which they were
    counted."""
    curve: tuple[Floats, Floats]
    """Environment steps, and mean return of the last 100 training episodes there."""
    moved: dict[str, float]
    """Where ψ moves: its last value, and the mean of σ(s_0) over the last tenth of the run."""
    evaluation: dict[str, Any]
    """evaluation.json; empty: there is none."""
    result: dict[str, Any]
    facts: dict[str, Any]

    def last(self, count: int) -> float:
        """Mean return of the last training episodes."""
        return float(self.returns[-count:].mean())

    def episodes(self, start: str) -> list[dict[str, Any]]:
        """Evaluation episodes of one kind of start."""
        return [
            one for one in self.evaluation.get("episodes", []) if one.get("start", "free") == start
        ]


@dataclass(frozen=True, slots=True, kw_only=True)
class Cell:
    """One arm on one environment."""

    env: str
    arm: str
    runs: tuple[Run, ...]
    """All that were planned."""
    finished: tuple[Finished, ...]
    """In the order of their seeds, those without any finished training episode left out."""

    @property
    def psi(self) -> float:
        """ψ."""
        return self.runs[0].psi

    @property
    def label(self) -> str:
        """For tables and figures; ψ is part of it if it says more."""
        weight, alone = self.runs[0].weight, (*_PLAIN_ARMS, f"psi{self.psi:g}")
        return weight if self.arm in alone else f"{self.arm} ({weight})"

    def scores(self, count: int) -> Floats:
        """[n] mean return of the last training episodes of each seed."""
        return np.array([one.last(count) for one in self.finished])

    def scores_at(self, steps: int) -> Floats:
        """[n] mean return of the last 100 training episodes of each seed, so far into the run."""
        return np.array(
            [np.interp(steps, *one.curve) for one in self.finished if len(one.curve[0])]
        )

    def evaluated(self, start: str, name: str) -> Floats | None:
        """[n, E] a number of the evaluation episodes of the seeds that have been evaluated.

        None: none has, or an episode lacks it.
        """
        rows = []
        for episodes in filter(None, (one.episodes(start) for one in self.finished)):
            if any(name not in episode for episode in episodes):
                return None
            rows.append([float(episode[name]) for episode in episodes])
        if not rows:
            return None
        fewest = min(map(len, rows))
        return np.array([row[:fewest] for row in rows])


def cells(folder: Folder, grid: Grid) -> list[Cell]:
    """Arms on environments in the order of the plan."""
    found: dict[tuple[str, str], list[Run]] = {}
    for run in grid.runs:
        found.setdefault((run.env, run.arm), []).append(run)
    return [
        Cell(env=env, arm=arm, runs=tuple(runs), finished=tuple(_all_finished(folder, runs)))
        for (env, arm), runs in found.items()
    ]


def _all_finished(folder: Folder, runs: list[Run]) -> Iterator[Finished]:
    for run in sorted(runs, key=lambda one: one.seed):
        if folder.is_trained(run):
            one = _finished(folder, run)
            if len(one.returns):
                yield one


def _finished(folder: Folder, run: Run) -> Finished:
    path = folder.run(run)
    rows = curve_rows(path, run)
    episodes = [row["returns"] for row in json_lines(path / "episodes.jsonl")]
    return Finished(
        run=run,
        returns=np.array([score for scores in episodes for score in scores], np.float64),
        curve=(
            np.array([row["time/total_timesteps"] for row in rows], np.float64),
            np.array([row["rollout/ep_rew_mean"] for row in rows], np.float64),
        ),
        moved=_moved(rows) if run.moves_psi else {},
        evaluation=folder.evaluation(run),
        result=folder.result(run),
        facts=folder.facts(run),
    )


def curve_rows(path: Path, run: Run) -> list[dict[str, Any]]:
    """What the learning curve of a run directory consists of, with ψ where it moves."""
    also = _MOVED if run.moves_psi else ()
    return [
        {name: row[name] for name in (*_CURVE, *also) if name in row}
        for row in json_lines(path / "metrics.jsonl")
        if all(name in row for name in _CURVE)
    ]


def _moved(rows: list[dict[str, Any]]) -> dict[str, float]:
    found = {}
    for name, share in zip(_MOVED, (0.0, 0.1), strict=True):
        values = [row[name] for row in rows if name in row]
        last = values[-max(1, round(share * len(values))) :]
        if last:
            found[name.rpartition("/")[2]] = float(np.mean(last))
    return found


def json_lines(file: Path) -> Iterator[dict[str, Any]]:
    """Whole lines of a file of JSON lines."""
    if not file.exists():
        return
    with file.open("rb") as lines:
        for line in lines:
            try:
                row = json.loads(line)
            except ValueError:
                continue  # torn by a power cut
            if isinstance(row, dict):
                yield row


def curve_of(cell: Cell) -> dict[str, Floats] | None:
    """Steps, mean and spread (NaN of one seed) of the cell's learning curves; None: no curve."""
    curves = [one.curve for one in cell.finished if len(one.curve[0])]
    if not curves:
        return None
    first = max(steps[0] for steps, _ in curves)
    last = min(steps[-1] for steps, _ in curves)
    steps = np.linspace(first, max(first, last), POINTS)
    scores = np.array([np.interp(steps, *curve) for curve in curves])
    spread = scores.std(axis=0, ddof=1) if len(scores) > 1 else np.full(POINTS, np.nan)
    return {"steps": steps, "mean": scores.mean(axis=0), "std": spread}
