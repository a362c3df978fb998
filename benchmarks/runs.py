"""Training runs as a user starts them, and what they have reached so far."""

import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Self

from benchmarks.measuring import rss_mb
from benchmarks.processes import SkippedError, family, started

Row = dict[str, float]
STEPS, TIME = "time/total_timesteps", "time"


class Run:
    """One trainer at work in a folder of its own; a context manager that ends it."""

    def __init__(self, command: Callable[[Path], list[str]], patience: float = 10.0) -> None:
        """`command` is told the file that the trainer appends its rows to.

        `patience`: how long it may take to end by itself [s].
        """
        self._patience = patience
        self._folder = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        self.marks = Path(self._folder.name) / "run" / "metrics.jsonl"
        self.output = Path(self._folder.name) / "output.txt"
        self.begun = time.time()
        with self.output.open("w") as output:
            self._tree = started(
                command(self.marks),
                {},
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
        self.process = self._tree.process

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """As a user would, and then for certain: nothing that it has started is left."""
        try:
            self._tree.end(self._patience)
        finally:
            self._folder.cleanup()

    @property
    def memory_mb(self) -> float:
        """Resident memory of all its processes now."""
        return sum(rss_mb(pid) for pid in family(self.process.pid))

    def rows(self) -> list[Row]:
        """The whole lines so far, from step 0 on."""
        text = self.marks.read_text() if self.marks.exists() else ""
        rows = [json.loads(line) for line in text.splitlines(keepends=True) if line[-1] == "\n"]
        if rows and "charts/SPS" in rows[0]:  # dppo's first row ends its first iteration
            seconds = rows[0][STEPS] / rows[0]["charts/SPS"]
            rows.insert(0, {STEPS: 0.0, TIME: rows[0][TIME] - seconds})
        return rows

    def trained(self, seconds: float) -> list[Row]:
        """Rows at step 0, after the first iteration, and until `seconds` after that, at least 1.

        Raises:
            SkippedError: the process ended by itself; its last words.
        """
        rows: list[Row] = []
        while len(rows) < 3 or rows[-1][TIME] - rows[1][TIME] < seconds:
            if self.process.poll() is not None:
                words = self.output.read_text().strip().splitlines()
                raise SkippedError(words[-1] if words else f"code {self.process.returncode}")
            time.sleep(0.05)
            rows = self.rows()
        return rows


def speed(rows: list[Row]) -> float:
    """Environment steps per second, whole iterations after the first one."""
    return (rows[-1][STEPS] - rows[1][STEPS]) / (rows[-1][TIME] - rows[1][TIME])


def dppo(env: str, *words: str, steps: int = 10_000_000) -> Callable[[Path], list[str]]:
    """The command that a user gives, with the settings that the goals are about."""
    return lambda marks: [
        sys.executable, "-m", "learner", "--env", env, "--psi", "0.1", "--slots", "8",
        "--total-timesteps", str(steps), "--run-dir", str(marks.parent), *words,
    ]  # fmt: skip


def peer(trainer: str, env: str, python: str) -> Callable[[Path], list[str]]:
    """One of `benchmarks.peers`."""

    def command(marks: Path) -> list[str]:
        marks.parent.mkdir()
        return [python, "-m", "benchmarks.peers", trainer, env, str(marks)]

    return command
