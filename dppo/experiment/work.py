"""The loop of an experiment: starts the next process, looks after those that run, reports."""

import signal
import time
from dataclasses import dataclass

from dppo.experiment.console import Console, Standing
from dppo.experiment.folder import Folder
from dppo.experiment.pace import GridPace
from dppo.experiment.plan import Grid, Run, in_order
from dppo.experiment.processes import Child, Reporter, outcome, start
from dppo.experiment.schedule import Schedule, Stage, Task
from dppo.signals import Signals

_LOOK_SECONDS = 1.0
_GRACE_SECONDS = 7.0
"""For saving after SIGTERM; what is left then is killed."""
_ORPHAN_SECONDS = 60.0
"""For learners of an experiment that was killed: they notice, save and end."""
_SILENCE_SECONDS = 1800.0
"""A trainer that logs no iteration for so long hangs, and is ended."""


@dataclass(slots=True)
class Watch:
    """What the newest look at a running trainer has found."""

    steps: int
    since: float
    """When it made its last step."""
    score: float | None = None


class Work:
    """All runs of a grid, `jobs` at a time."""

    def __init__(self, folder: Folder, grid: Grid, jobs: int, console: Console) -> None:
        """Takes over the signals of this process."""
        self._folder, self._grid, self._jobs, self._console = folder, grid, jobs, console
        self._signals = Signals()
        runs = in_order(grid.runs)
        self.schedule = Schedule(
            runs,
            trained={run.name for run in runs if folder.is_trained(run)},
            evaluated={run.name for run in runs if folder.is_evaluated(run, grid.evaluate)},
        )
        self._pace = GridPace(jobs)
        self._begun = time.monotonic()
        self._children: list[Child] = []
        self._watches: dict[str, Watch] = {}
        self._steps = {run.name: self._steps_of(run) for run in runs}
        self._reporter = Reporter(folder.path)
        self.report_problem = ""
        """Why the last report could not be written."""

    def run(self) -> bool:
        """Until everything is over and reported, or somebody asks for an end: was it over?"""
        try:
            while not self.schedule.is_over:
                self._start_what_can_be()
                number = self._signals.next(_LOOK_SECONDS)
                if number in (signal.SIGTERM, signal.SIGINT):
                    return self._stop()
                for child in [child for child in self._children if child.has_ended]:
                    self._ended(child)
                self._look()
            return self._report_at_last()
        finally:
            self._reporter.end()
            for child in self._children:  # only after an error of our own: they save and end
                child.ask_to_end()

    def _start_what_can_be(self) -> None:
        now = time.monotonic()
        busy = set()
        if now - self._begun < _ORPHAN_SECONDS:
            busy = {
                task.run.name for task in self.schedule.waiting if self._folder.is_in_use(task.run)
            }
        while len(self._children) < self._jobs and (task := self.schedule.start(busy)):
            try:
                child = start(self._folder, task, self._grid.evaluate, now)
            except OSError as error:  # no memory, no room for its log
                self._failed(task, f"it cannot be started: {error}")
                continue
            self._children.append(child)
            self._watches[task.run.name] = Watch(child.steps, now)
            if task.stage is Stage.TRAIN:
                again = f", goes on at {child.steps:,} steps" if child.steps else ""
                self._console.say(f"{task.run.name}: training{again}")

    def _ended(self, child: Child) -> None:
        """Note what came of a process."""
        self._children.remove(child)
        task = child.task
        try:
            reason = outcome(self._folder, child)
        except OSError as error:
            reason = f"what it has left cannot be kept: {error}"
        self._account(child)
        if reason:
            self._failed(task, reason)
        else:
            self.schedule.succeeded(task, self._grid.evaluate > 0)
            self._console.say(f"{task.run.name}: {self._said_of(task)}")
        if not self.schedule.is_over and self.schedule.is_seed_over(task.run.seed):
            self._note_failures()
            self._reporter.begin()

    def _failed(self, task: Task, reason: str) -> None:
        if self.schedule.failed_with(task, reason):
            self._console.say(f"{task.run.name}: {reason}; it is tried once more at the end")
        else:
            self._console.say(f"{task.run.name}: FAILED: {reason}")

    def _note_failures(self) -> None:
        """For the report."""
        try:
            self._folder.note_failures(self.schedule.failed, self._grid.runs)
        except OSError as error:  # the disk is full: what was said on the console remains
            self._console.say(f"failures.json cannot be written: {error}")

    def _report_at_last(self) -> bool:
        """The report over everything; False if somebody does not want to wait for it."""
        self._note_failures()
        self._reporter.end()
        self._reporter.begin()
        while not self._reporter.has_ended:
            if self._signals.next(_LOOK_SECONDS) in (signal.SIGTERM, signal.SIGINT):
                return False
        self.report_problem = self._reporter.problem
        return True

    def _said_of(self, task: Task) -> str:
        if task.stage is Stage.EVALUATE:
            return "evaluated"
        score = self._folder.result(task.run).get("episode_return_mean")
        return "trained" if score is None else f"trained, return {score:.1f}"

    def _account(self, child: Child) -> None:
        """How fast it was, for the time left."""
        run, watch = child.task.run, self._watches.pop(child.task.run.name)
        self._steps[run.name] = self._steps_of(run)
        if child.task.stage is Stage.TRAIN:
            seconds = time.monotonic() - child.begun
            self._pace.ended(run.env, max(0, watch.steps - child.steps), seconds)

    def _look(self) -> None:
        """Read how far the trainers are; end those that hang; show it."""
        now, moving = time.monotonic(), dict[str, tuple[float, float]]()
        for child in self._children:
            run, watch = child.task.run, self._watches[child.task.run.name]
            if child.task.stage is not Stage.TRAIN:
                continue
            row = self._folder.newest_row(run)
            steps = int(row.get("time/total_timesteps", 0))
            if steps != watch.steps:
                watch.steps, watch.since = steps, now
            watch.score = row.get("rollout/ep_rew_mean")
            self._steps[run.name] = steps
            made, seconds = moving.get(run.env, (0.0, 0.0))
            moving[run.env] = (made + max(0, steps - child.steps), seconds + now - child.begun)
            if now - watch.since > _SILENCE_SECONDS:
                minutes = _SILENCE_SECONDS / 60
                self._console.say(f"{run.name}: no iteration for {minutes:.0f} min, ending it")
                child.kill()
        self._console.show(self._standing(moving), now)

    def _standing(self, moving: dict[str, tuple[float, float]]) -> Standing:
        rest, whole, gone = [], 0.0, 0.0
        for run in self._grid.runs:
            cost = self._pace.seconds_per_step(run.env, moving)
            steps = min(self._steps[run.name], run.real_steps)
            whole += cost * run.real_steps
            gone += cost * (run.real_steps if run.name in self.schedule.failed else steps)
            if run.name not in self.schedule.failed:
                rest.append((run.env, run.real_steps - steps))
        return Standing(
            share=gone / whole,
            left=self._pace.left(rest, moving),
            runs=len(self._grid.runs),
            done=self.schedule.done,
            failed=len(self.schedule.failed),
            running=tuple(self._running(child) for child in self._children),
        )

    def _running(self, child: Child) -> tuple[float, str]:
        run, watch = child.task.run, self._watches[child.task.run.name]
        if child.task.stage is Stage.EVALUATE:
            return 1.0, f"{run.name} evaluation"
        score = "" if watch.score is None else f" return {watch.score:.0f}"
        return watch.steps / run.real_steps, f"{run.name}{score}"

    def _steps_of(self, run: Run) -> int:
        return run.real_steps if self._folder.is_trained(run) else self._folder.steps(run)

    def _stop(self) -> bool:
        """Ask all to save and end; a second signal, or time, ends them at once."""
        self._console.say(f"stopping {len(self._children)} runs, each with a checkpoint")
        for child in self._children:
            child.ask_to_end()
        until = time.monotonic() + _GRACE_SECONDS
        while any(not child.has_ended for child in self._children):
            number = self._signals.next(max(0.0, until - time.monotonic()))
            if number in (signal.SIGTERM, signal.SIGINT) or time.monotonic() >= until:
                break
        for child in self._children:
            if not child.has_ended:
                self._console.say(f"{child.task.run.name}: does not end, and is killed")
                child.kill()
        self._children = []
        self._note_failures()
        return False
