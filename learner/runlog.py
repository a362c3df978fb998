"""Reports to files: metrics, episodes, ledger and TensorBoard, in step with the checkpoints.

A resumed run takes up its files where the checkpoint stands: lines of iterations that will be run
again are cut off, so every iteration has one line. Nothing here waits for the disk; see `disk.py`.
"""

import contextlib
import csv
import io
import json
import logging
import os
import socket
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from dppo.store.ledger import Line, from_values, to_json
from learner.disk import Disk, GrowingFile
from learner.report import IterationReport

log = logging.getLogger("learner")
_COLUMNS = (
    "rollout/ep_rew_mean", "rollout/ep_len_mean", "charts/episodic_return", "charts/SPS",
    "train/kl", "train/kl_coef", "train/policy_updates", "train/policy_loss", "train/value_loss",
    "train/variance_loss", "train/explained_variance", "train/std", "train/reward_scale",
    "train/gamma", "train/policy_grad_norm", "train/value_grad_norm", "train/variance_grad_norm",
    "safety/psi", "safety/sigma_mean", "safety/start_sigma", "safety/return_std", "safety/cvar10",
    "safety/adv_v_std", "safety/adv_sigma_std", "cluster/workers", "cluster/round_ms",
    "cluster/dropped", "cluster/acceptance_min", "cluster/drop_return_correlation",
    "cluster/drop_length_correlation", "cluster/unsaved_iterations",
)  # fmt: skip
"""Of progress.csv; metrics.jsonl has the same."""
_HEADER = ("iteration", "time/total_timesteps", *_COLUMNS)


class RunLog:
    """The metric files of one run."""

    def __init__(
        self,
        folder: Path,
        iteration: int,
        disk: Disk,
        noted: Callable[[Line], object] = lambda _line: None,
    ) -> None:
        """Take up the files of a run that stands at the start of `iteration`.

        `noted` gets the ledger's lines so far, one after the other: there may be millions.
        """
        self._disk = disk
        rows: list[dict[str, Any]] = []
        self._metrics = _taken_up(folder / "metrics.jsonl", iteration, disk, rows.append)

        def keep(row: dict[str, Any]) -> None:
            if (line := _known(row)) is not None:
                noted(line)

        # the iteration under way notes what was dropped, counted from 0
        self._ledger = _taken_up(folder / "ledger.jsonl", iteration - 1, disk, keep)
        self._episodes = _taken_up(folder / "episodes.jsonl", iteration, disk, lambda _row: None)
        self._table = disk.file("progress.csv", 0)
        self._table.write(_cells([*_HEADER]) + b"".join(map(_row, rows)))
        self._board: Any = None

    def write(self, report: IterationReport, measured: dict[str, float]) -> None:
        """One iteration; `measured`: metrics that depend on how it ran."""
        metrics = report.metrics | measured
        row = {
            "iteration": report.iteration,
            "time/total_timesteps": report.env_steps,
            "time": time.time(),
            **metrics,
        }
        self._metrics.write(_line(row))
        self._table.write(_row(row))
        if report.episodes:
            returns, lengths = zip(*report.episodes, strict=True)
            ended = {"iteration": report.iteration, "returns": returns, "lengths": lengths}
            self._episodes.write(_line(ended))
        self._scalars(report.env_steps, metrics | {"time/fps": metrics["charts/SPS"]})

    def note(self, line: Line) -> None:
        """One ledger line."""
        self._ledger.write((to_json(line) + "\n").encode())

    def close(self) -> None:
        """Wait until everything is written that the disk takes."""
        self._disk.settle()

    def _scalars(self, env_steps: int, metrics: dict[str, float]) -> None:
        """To TensorBoard; x axis: environment steps. Imported late: it takes half a second.

        Not through TensorBoard's own event writer: it blocks when its queue is full, and its
        thread ends at the first error of the disk.
        """
        from tensorboard.compat.proto.event_pb2 import Event, SessionLog
        from tensorboard.compat.proto.summary_pb2 import Summary
        from tensorboard.summary.writer.record_writer import RecordWriter

        now = time.time()
        if self._board is None:
            name = f"events.out.tfevents.{int(now):010d}.{socket.gethostname()}.{os.getpid()}.0"
            self._board = RecordWriter(self._disk.file(name, 0))
            start = SessionLog(status=SessionLog.START)  # TensorBoard drops what was beyond it
            for event in (
                Event(wall_time=now, file_version="brain.Event:2"),
                Event(wall_time=now, step=env_steps, session_log=start),
            ):
                self._board.write(event.SerializeToString())
        values = [Summary.Value(tag=name, simple_value=value) for name, value in metrics.items()]
        event = Event(wall_time=now, step=env_steps, summary=Summary(value=values))
        self._board.write(event.SerializeToString())


def _taken_up(
    path: Path, iteration: int, disk: Disk, keep: Callable[[dict[str, Any]], None]
) -> GrowingFile:
    """A file of JSON lines without those of iterations beyond `iteration`; `keep` gets the others.

    Lines are in the order of their iterations. What is torn at the end is cut off; what cannot be
    read before other lines was damaged later, and stays.
    """
    size, place, ends, odd, damaged = 0, 0, True, 0, 0
    with contextlib.ExitStack() as stack:
        for line in stack.enter_context(path.open("rb")) if path.exists() else ():
            row, place = _parsed(line), place + len(line)
            if row is None:
                odd += 1
                continue
            if row["iteration"] > iteration:
                break
            size, ends, damaged = place, line.endswith(b"\n"), odd
            keep(row)
    if damaged:
        log.warning("cannot read %d of the lines of %s; they stay as they are", damaged, path)
    file = disk.file(path.name, size)
    if not ends:
        file.write(b"\n")
    return file


def _parsed(line: bytes) -> dict[str, Any] | None:
    try:
        row = json.loads(line)
    except ValueError:
        return None
    whole = isinstance(row, dict) and isinstance(row.get("iteration"), int)
    return row if whole else None


def _known(row: dict[str, Any]) -> Line | None:
    """A line of the ledger; one that is damaged or of an older version must not end the run."""
    try:
        return from_values(row)
    except ValueError as error:
        log.warning("left out of the accounts of dropping, a line of ledger.jsonl: %s", error)
        return None


def _line(row: dict[str, Any]) -> bytes:
    return (json.dumps(row) + "\n").encode()


def _row(row: dict[str, Any]) -> bytes:
    return _cells([row.get(name, "") for name in _HEADER])


def _cells(cells: list[Any]) -> bytes:
    text = io.StringIO()
    csv.writer(text).writerow(cells)
    return text.getvalue().encode()
