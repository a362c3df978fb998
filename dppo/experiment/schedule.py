"""Which run is next. A state machine without process and clock.

A run is trained, then evaluated. What was interrupted is trained on, or evaluated. One that fails
is tried once more after all others, whatever the reason: it costs seconds if it fails at once.
"""

from collections.abc import Collection
from dataclasses import dataclass
from enum import Enum

from dppo.experiment.plan import Run


class Stage(Enum):
    """What is to be done of a run."""

    TRAIN = "training"
    EVALUATE = "evaluation"


@dataclass(frozen=True, slots=True)
class Task:
    """One process to start."""

    run: Run
    stage: Stage


class Schedule:
    """Tasks that wait, run, or are over; runs that have failed."""

    def __init__(
        self, runs: list[Run], *, trained: Collection[str], evaluated: Collection[str]
    ) -> None:
        """Runs in the order of their start; names of those of which a stage is done already."""
        self._waiting = [
            Task(run, Stage.EVALUATE if run.name in trained else Stage.TRAIN)
            for run in runs
            if run.name not in evaluated
        ]
        # what is trained already needs little: it comes first
        self._waiting.sort(key=lambda task: task.stage is Stage.TRAIN)
        self.running: list[Task] = []
        self.failed: dict[str, str] = {}
        """Name of a run to the reason."""
        self._tried: set[str] = set()
        self._all = {run.name: run for run in runs}

    @property
    def waiting(self) -> tuple[Task, ...]:
        """In the order of their start."""
        return tuple(self._waiting)

    @property
    def is_over(self) -> bool:
        """Nothing runs and nothing waits."""
        return not self.running and not self._waiting

    @property
    def done(self) -> int:
        """Runs of which nothing is left to do, the failed ones not among them."""
        open_ones = {task.run.name for task in (*self._waiting, *self.running)}
        return sum(name not in open_ones and name not in self.failed for name in self._all)

    def start(self, busy: Collection[str] = ()) -> Task | None:
        """The next task, which runs from here on; none of a run whose folder is in use."""
        for task in self._waiting:
            if task.run.name not in busy:
                self._waiting.remove(task)
                self.running.append(task)
                return task
        return None

    def succeeded(self, task: Task, evaluate: bool) -> None:
        """The task is over; after training comes the evaluation, if there is to be one."""
        self.running.remove(task)
        if task.stage is Stage.TRAIN and evaluate:
            self._waiting.insert(0, Task(task.run, Stage.EVALUATE))

    def failed_with(self, task: Task, reason: str) -> bool:
        """The task has failed; will it be tried once more?"""
        self.running.remove(task)
        if task.run.name not in self._tried:
            self._tried.add(task.run.name)
            self._waiting.append(task)
            return True
        self.failed[task.run.name] = reason
        return False

    def is_seed_over(self, seed: int) -> bool:
        """No run of this seed waits or runs: a whole comparison more is there."""
        tasks = (*self._waiting, *self.running)
        return all(task.run.seed != seed for task in tasks)
