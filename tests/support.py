"""The local harness: real learners and real workers as processes over loopback."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from dppo.store.checkpoint import Checkpoint, load_checkpoint

ROOT = Path(__file__).parents[1]
DEADLINE = 120.0
"""Longest wait for one fact [s]; only a broken run takes it."""
SMALL = (
    "--slots", "8", "--num-envs", "1", "--num-steps", "64", "--update-epochs", "2",
    "--num-minibatches", "2", "--psi", "0.1",
)  # fmt: skip
"""A run whose iterations take a fraction of a second."""


def wait_until(fact: Callable[[], bool], what: str, deadline: float = DEADLINE) -> None:
    """Wait for a fact of the outside world; fail with its name."""
    until = time.monotonic() + deadline
    while not fact():
        assert time.monotonic() < until, f"waited {deadline:g} s for {what}"
        time.sleep(0.02)


@dataclass
class Process:
    """One real process, its output in a file."""

    popen: subprocess.Popen[bytes]
    output: Path

    @property
    def text(self) -> str:
        return self.output.read_text()

    def wait(self, deadline: float = DEADLINE) -> int:
        return self.popen.wait(deadline)

    def kill(self) -> None:
        self.popen.kill()
        self.popen.wait()

    def send(self, number: signal.Signals) -> None:
        self.popen.send_signal(number)


@dataclass
class Harness:
    """Starts learners and workers; ends what is left of them."""

    folder: Path
    processes: list[Process] = field(default_factory=list)

    def start(self, module: str, *args: str, environment: dict[str, str] | None = None) -> Process:
        output = self.folder / f"{module}-{len(self.processes)}.txt"
        with output.open("wb") as file:
            popen = subprocess.Popen(
                [sys.executable, "-m", module, *args],
                stdout=file,
                stderr=subprocess.STDOUT,
                stdin=subprocess.DEVNULL,
                env=os.environ | (environment or {}),
            )
        process = Process(popen, output)
        self.processes.append(process)
        return process

    def learner(self, *args: str, run_dir: Path) -> Process:
        return self.start("learner", *args, "--run-dir", str(run_dir))

    def worker(self, address: str, *args: str) -> Process:
        return self.start("workers", "--connect", address, *args)

    def train(self, *args: str, run_dir: Path) -> dict[str, Any]:
        """A learner from start to end; its result.json."""
        process = self.learner(*args, run_dir=run_dir)
        assert process.wait() == 0, process.text
        return result(run_dir)

    def end(self) -> None:
        for process in self.processes:
            if process.popen.poll() is None:
                process.kill()


def result(run_dir: Path) -> dict[str, Any]:
    values: dict[str, Any] = json.loads((run_dir / "result.json").read_text())
    return values


def iterations(run_dir: Path) -> int:
    """Iterations that the run has logged so far."""
    file = run_dir / "metrics.jsonl"
    return len(file.read_text().splitlines()) if file.exists() else 0


def checkpoints(run_dir: Path) -> list[str]:
    return sorted(path.name for path in (run_dir / "checkpoints").glob("iteration-*"))


def newest_checkpoint(run_dir: Path) -> Checkpoint:
    return load_checkpoint(run_dir / "checkpoints" / checkpoints(run_dir)[-1])


def descendants(pid: int) -> list[int]:
    """Living child processes of `pid`."""
    children = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = stat.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[1]) == pid and fields[0] != "Z":
            children.append(int(stat.parent.name))
    return children


def state_of(pid: int) -> str:
    """One letter, as in /proc: R running, S sleeping, T stopped, Z ended; empty: gone."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return ""


def catches(pid: int, number: signal.Signals) -> bool:
    """A process of that number has a handler for the signal."""
    status = Path(f"/proc/{pid}/status").read_text()
    (caught,) = [line.split()[1] for line in status.splitlines() if line.startswith("SigCgt")]
    return bool(int(caught, 16) >> (number - 1) & 1)


def is_alive(pid: int) -> bool:
    return state_of(pid) not in ("", "Z")


def printed(*words: str | Path) -> str:
    """What a Python process prints; it has to succeed."""
    done = subprocess.run(
        [sys.executable, *map(str, words)],
        cwd=ROOT,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout
