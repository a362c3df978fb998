"""Processes of an experiment: one trainer or one evaluation each, in sessions of their own."""

import contextlib
import json
import os
import signal
import subprocess
import tempfile
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from dppo.errors import UsageError
from dppo.experiment.evaluation import evaluation_words, normalised
from dppo.experiment.folder import Folder
from dppo.experiment.plan import Run
from dppo.experiment.schedule import Stage, Task
from dppo.machine import own_program

_TRAINER = (
    "--local-workers", "1", "--listen", "auto", "--resume", "auto", "--keep-checkpoints", "2",
)  # fmt: skip
"""One worker: see decision 0014. Two checkpoints: the newest may be damaged."""


@dataclass(slots=True)
class Child:
    """A process at work on a task; what it prints goes to the run's log."""

    task: Task
    popen: subprocess.Popen[bytes]
    begun: float
    """When it was started, on the caller's clock."""
    steps: int
    """Environment steps that the run had then."""
    answer: IO[bytes] | None = None
    """Where an evaluation writes: a file without a name, so that an orphan spoils nothing."""

    @property
    def has_ended(self) -> bool:
        """It is over."""
        return self.popen.poll() is not None

    def ask_to_end(self) -> None:
        """SIGTERM: a learner saves what it has."""
        self._send(signal.SIGTERM)

    def kill(self) -> None:
        """End it and what it has started at once."""
        self._send(signal.SIGKILL)
        self.popen.wait()

    def _send(self, number: signal.Signals) -> None:
        with contextlib.suppress(ProcessLookupError):
            if number == signal.SIGKILL:
                os.killpg(self.popen.pid, number)
            else:
                self.popen.send_signal(number)


def check_environments(runs: Iterable[Run]) -> None:
    """Make each environment once, in another process.

    Raises:
        UsageError: one cannot be made; says why.
    """
    wanted = {(run.env, run.config.run.env_kwargs) for run in runs}
    if not wanted:
        return
    done = subprocess.run(
        own_program("workers.environments", json.dumps(sorted(wanted))),
        stdin=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        errors="replace",
        check=False,
    )
    if done.returncode != 0:
        said = done.stderr.strip().splitlines() or [f"exit code {done.returncode}"]
        raise UsageError(said[-1].removeprefix("error: "))


def trainer_words(folder: Folder, task: Task) -> list[str]:
    """`dppo-learner`'s flags for a run."""
    return [*task.run.words, *_TRAINER, "--run-dir", str(folder.run(task.run))]


def start(folder: Folder, task: Task, episodes: int, now: float) -> Child:
    """Start the process of a task."""
    if task.stage is Stage.TRAIN:
        # the learner ends with its parent, as it does with its supervisor
        words = ["learner", "--supervised", str(os.getpid()), *trainer_words(folder, task)]
        answer = None
    else:
        words = ["dppo", *evaluation_words(folder.run(task.run), task.run.config, episodes)]
        answer = tempfile.TemporaryFile()  # noqa: SIM115  lives as long as the process
    steps = folder.steps(task.run)
    with folder.log(task.run).open("ab") as log:
        popen = subprocess.Popen(
            own_program(*words),
            stdin=subprocess.DEVNULL,
            stdout=answer or log,
            stderr=log,
            start_new_session=True,  # Ctrl-C is for the experiment alone
        )
    return Child(task, popen, now, steps, answer)


def outcome(folder: Folder, child: Child) -> str:
    """Keep what a process that has ended leaves; the reason why it has failed, or nothing."""
    code = child.popen.returncode
    if code != 0:
        return _reason(folder, child, code)
    run = child.task.run
    if child.task.stage is Stage.TRAIN:
        status = folder.result(run).get("status", "missing")
        if status != "finished":
            return f"its learner ended with exit code 0, but result.json is {status}"
        folder.thin_out(run)
        return ""
    assert child.answer is not None
    child.answer.seek(0)
    try:
        found = normalised(json.loads(child.answer.read()))
    except ValueError as error:
        return f"its evaluation printed no JSON that can be used: {error}"
    path = folder.run(run).relative_to(folder.path) / "evaluation.json"
    folder.write(str(path), json.dumps(found) + "\n")
    return ""


def _reason(folder: Folder, child: Child, code: int) -> str:
    """What the process has said, or how it ended."""
    result = folder.result(child.task.run)
    if child.task.stage is Stage.TRAIN and result.get("status") == "failed" and code == 1:
        return str(result.get("reason", "it does not say why"))
    how = f"ended by signal {-code}" if code < 0 else f"ended with exit code {code}"
    said = last_error(folder.log(child.task.run)) if code > 0 else ""
    return f"{child.task.stage.value} {how}{': ' if said else ''}{said}"


def last_error(log: Path) -> str:
    """The last error that a log tells of, or else its last line."""
    try:
        with log.open("rb") as file:
            file.seek(max(0, log.stat().st_size - 65536))
            lines = file.read().decode(errors="replace").splitlines()
    except OSError:
        return ""
    told = [line.partition("error: ")[2] for line in lines if line.startswith("error: ")]
    full = [line for line in lines if line.strip()]
    return (told or full or [""])[-1]


class Reporter:
    """Writes the report in a process of its own: nothing waits for it, and no fault of it ends us.

    One that is begun while another is at work is left out: the last one is always made.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._popen: subprocess.Popen[bytes] | None = None
        self._said: IO[bytes] | None = None

    @property
    def has_ended(self) -> bool:
        """None is being written."""
        return self._popen is None or self._popen.poll() is not None

    @property
    def problem(self) -> str:
        """Why the last one could not be written; empty: it could."""
        if self._popen is None or self._said is None or self._popen.poll() == 0:
            return ""
        self._said.seek(0)
        lines = self._said.read().decode(errors="replace").split("\n")
        return next((line for line in reversed(lines) if line.strip()), "it says nothing")

    def begin(self) -> None:
        """Start to write one."""
        if not self.has_ended:
            return
        self._said = tempfile.TemporaryFile()  # noqa: SIM115  lives as long as the process
        self._popen = subprocess.Popen(
            own_program("dppo", "experiment", "report", str(self._folder)),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=self._said,
            start_new_session=True,
        )

    def end(self) -> None:
        """End it if it is at work."""
        if self._popen is not None and self._popen.poll() is None:
            self._popen.kill()
            self._popen.wait()
