"""Reports to files: metrics, ledger and TensorBoard, in step with the checkpoints.

A resumed run takes up its files where the checkpoint stands: lines of iterations that will be run
again are cut off, so every iteration has one line.
"""

import csv
import json
import time
from pathlib import Path
from typing import Any

from dppo.store.ledger import Line, to_json
from learner.report import IterationReport

_COLUMNS = (
    "rollout/ep_rew_mean", "rollout/ep_len_mean", "charts/episodic_return", "charts/SPS",
    "train/kl", "train/kl_coef", "train/policy_updates", "train/policy_loss", "train/value_loss",
    "train/variance_loss", "train/explained_variance", "train/reward_scale",
    "train/policy_grad_norm", "train/value_grad_norm", "train/variance_grad_norm",
    "safety/psi", "safety/sigma_mean", "safety/return_std", "safety/cvar10", "safety/adv_v_std",
    "safety/adv_sigma_std", "cluster/workers", "cluster/round_ms", "cluster/dropped",
    "cluster/acceptance_min", "cluster/drop_return_correlation", "cluster/drop_length_correlation",
)  # fmt: skip
"""Of progress.csv; metrics.jsonl has the same."""


class RunLog:
    """The metric files of one run."""

    def __init__(self, folder: Path, iteration: int) -> None:
        """Open the files of a run that stands at the start of `iteration`."""
        self._folder = folder
        _cut(folder / "metrics.jsonl", iteration)
        _cut(folder / "ledger.jsonl", iteration - 1)  # noted by the iteration under way, from 0
        self._metrics = (folder / "metrics.jsonl").open("a")
        self._ledger = (folder / "ledger.jsonl").open("a")
        self._csv = (folder / "progress.csv").open("w", newline="")
        self._table = csv.writer(self._csv)
        self._table.writerow(["iteration", "time/total_timesteps", *_COLUMNS])
        for line in (folder / "metrics.jsonl").read_text().splitlines():
            self._row(json.loads(line))
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
        self._metrics.write(json.dumps(row) + "\n")
        self._metrics.flush()
        self._row(row)
        self._csv.flush()
        self._scalars(report.env_steps, metrics | {"time/fps": metrics["charts/SPS"]})

    def note(self, line: Line) -> None:
        """One ledger line."""
        self._ledger.write(to_json(line) + "\n")
        self._ledger.flush()

    def close(self) -> None:
        """Flush everything."""
        for file in (self._metrics, self._ledger, self._csv):
            file.close()
        if self._board is not None:
            self._board.close()

    def _row(self, row: dict[str, Any]) -> None:
        cells = [row.get(name, "") for name in _COLUMNS]
        self._table.writerow([row["iteration"], row["time/total_timesteps"], *cells])

    def _scalars(self, env_steps: int, metrics: dict[str, float]) -> None:
        """To TensorBoard; x axis: environment steps. Imported late: it takes half a second."""
        from tensorboard.compat.proto.event_pb2 import Event, SessionLog
        from tensorboard.compat.proto.summary_pb2 import Summary
        from tensorboard.summary.writer.event_file_writer import EventFileWriter

        if self._board is None:
            self._board = EventFileWriter(str(self._folder))
            start = SessionLog(status=SessionLog.START)  # TensorBoard drops what was beyond it
            self._board.add_event(Event(wall_time=time.time(), step=env_steps, session_log=start))
        values = [Summary.Value(tag=name, simple_value=value) for name, value in metrics.items()]
        self._board.add_event(
            Event(wall_time=time.time(), step=env_steps, summary=Summary(value=values))
        )


def _cut(file: Path, iteration: int) -> None:
    """Keep the lines of iterations up to `iteration`; drop a torn last line."""
    if not file.exists():
        return
    kept = []
    for line in file.read_text().splitlines():
        try:
            row = json.loads(line)
        except ValueError:
            break
        if row["iteration"] <= iteration:
            kept.append(line)
    draft = file.with_name(f".{file.name}.draft")
    draft.write_text("".join(line + "\n" for line in kept))
    draft.rename(file)
