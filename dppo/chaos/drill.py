"""One run with its faults, over real processes, from start to end.

Faults happen at progress points of the run, or in a soak by the clock. A run that makes no
progress is ended, with the name of what did not come. Whatever happens, nothing is left running.
"""

import contextlib
import secrets
import signal
import subprocess
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from dppo.chaos.cast import Cast, Setup
from dppo.chaos.outcome import FaultRecord, Outcome, Series
from dppo.chaos.plan import Fault, Plan
from dppo.chaos.processes import (
    Usage,
    listeners,
    marked,
    shared_memory_of,
    wait_for_end,
)
from dppo.chaos.progress import Progress, median_seconds
from dppo.errors import RunFailedError
from dppo.store.reading import read_object

_LOOK_SECONDS = 0.01
_LAST_LOOKS = 5
_SAMPLE_SECONDS = 1.0
_END_SECONDS = 3.0
"""How long everybody has to end once the run is over, and again once told to."""
_PAUSE_SECONDS = 30.0
"""How long a learner has to end when it is told to."""


@dataclass(frozen=True, slots=True)
class ByIteration:
    """Faults happen when the run has logged their iteration."""

    plan: Plan
    patience: float = 120.0
    """Longest wait for the next iteration [s]."""


@dataclass(frozen=True, slots=True)
class ByClock:
    """Faults happen one after the other, every so many seconds; at the end the run pauses."""

    faults: Iterator[Fault]
    every: float
    seconds: float
    patience: float = 120.0


class Drill:
    """Carries out one schedule of faults against one run."""

    def __init__(
        self, setup: Setup, schedule: ByIteration | ByClock, folder: Path, seed: int = 0
    ) -> None:
        """`folder` gets the run directory and everybody's output."""
        self._schedule = schedule
        self._mark = secrets.token_hex(8)
        self._outcome, self._series = Outcome(), Series()
        self._shared: set[Path] = set()
        self._sampled = 0.0
        self._cast: Cast | None = None
        self._setup, self._folder, self._seed = setup, folder, seed
        self._waiting = list(schedule.plan.faults) if isinstance(schedule, ByIteration) else []

    def run(self) -> Outcome:
        """From the start of the learner to the end of the last process.

        Raises:
            UsageError: the learner refuses to begin the run.
        """
        self._begun = time.monotonic()
        try:
            self._cast = cast = Cast(self._setup, self._folder, self._mark, self._seed)
            self._progress = Progress(cast.run_dir, self._begun)
            try:
                self._watch(cast)
            except RunFailedError as error:
                self._outcome.problem = str(error)
            self._outcome.seconds = time.monotonic() - self._begun
            cast.calm()
            self._see_off(cast)
            self._conclude(cast)
        finally:
            for _ in range(_LAST_LOOKS):  # one that was just being started shows its mark late
                for handle in marked(self._mark):
                    handle.send(signal.SIGKILL)
                time.sleep(_LOOK_SECONDS)
            if self._cast is not None:
                self._cast.close()
        return self._outcome

    def _watch(self, cast: Cast) -> None:
        """Until the run is over.

        Raises:
            RunFailedError: it cannot be finished.
            UsageError: it cannot be begun.
        """
        while not cast.is_over():
            now = time.monotonic()
            highest = self._progress.look(now)
            self._note_recovery(highest, now)
            for fault in self._due(highest, now):
                said = cast.inject(fault, now)
                self._outcome.faults.append(
                    FaultRecord(fault, highest, time.monotonic() - self._begun, said)
                )
            cast.look_after(now)
            self._sample(cast, now)
            if now - self._progress.since > self._schedule.patience:
                raise RunFailedError(self._what_is_missing(cast))
            if isinstance(self._schedule, ByClock) and now - self._begun > self._schedule.seconds:
                self._pause(cast)
                return
            time.sleep(_LOOK_SECONDS)
        self._note_recovery(self._progress.look(time.monotonic()), time.monotonic())

    def _due(self, highest: int, now: float) -> list[Fault]:
        """Faults that happen now."""
        if isinstance(self._schedule, ByClock):
            schedule, count = self._schedule, len(self._outcome.faults)
            last = schedule.seconds - min(schedule.every, schedule.seconds / 10)
            at = (count + 1) * schedule.every
            begun = highest > 0 and at <= now - self._begun and at <= last
            return [next(schedule.faults)] if begun else []
        due = [fault for fault in self._waiting if fault.at <= highest]
        self._waiting = self._waiting[len(due) :]
        return due

    def _note_recovery(self, highest: int, now: float) -> None:
        for record in self._outcome.faults:
            if record.recovered is None and highest > record.iteration:
                record.recovered = now - self._begun - record.begun

    def _what_is_missing(self, cast: Cast) -> str:
        faults = [f"{one.fault.fault} of {one.fault.target}" for one in self._outcome.faults[-5:]]
        return (
            f"iteration {self._progress.highest + 1} did not come within "
            f"{self._schedule.patience:g} s; the last faults were {', '.join(faults) or 'none'}; "
            f"the learner's log ends with: {_end_of(cast.run_dir / 'log.txt')}"
        )

    def _pause(self, cast: Cast) -> None:
        """End a soak: nothing is disturbed any more, the learner saves and ends.

        Raises:
            RunFailedError: it does not.
        """
        cast.calm()
        cast.learner.popen.send_signal(signal.SIGTERM)
        try:
            code = cast.learner.popen.wait(_PAUSE_SECONDS)
        except subprocess.TimeoutExpired:
            raise RunFailedError(
                f"the learner did not end within {_PAUSE_SECONDS:g} s of SIGTERM; its log ends "
                f"with: {_end_of(cast.run_dir / 'log.txt')}"
            ) from None
        if code != 0:
            raise RunFailedError(
                f"the learner ended with exit code {code} after SIGTERM; it said: "
                f"{cast.learner.last_words()}"
            )

    def _sample(self, cast: Cast, now: float) -> None:
        """Look at everybody, once a second."""
        if now - self._sampled < _SAMPLE_SECONDS:
            return
        self._sampled = now
        children = [("learner", cast.learner.pid)]
        children += [(name, one.child.pid) for name, one in cast.externals.items()]
        children += [("local worker", handle.pid) for handle in cast.local_workers()]
        for name, pid in children:
            usage = Usage.of(pid)
            if usage is not None:
                self._series.add(name, pid, now, usage)
                self._shared |= shared_memory_of(pid)

    def _see_off(self, cast: Cast) -> None:
        """Everybody ends by themselves, or when told to; note who does neither."""
        wait_for_end(marked(self._mark), _END_SECONDS)
        for external in cast.externals.values():
            external.child.popen.send_signal(signal.SIGTERM)
        if self._outcome.problem:
            cast.learner.popen.kill()
            cast.learner.popen.wait()  # for all its threads: the last one lets go of its sockets
        for handle in wait_for_end(marked(self._mark), _END_SECONDS):
            self._outcome.left_behind.append(f"process {handle.pid}: {_command_of(handle.pid)}")

    def _conclude(self, cast: Cast) -> None:
        outcome = self._outcome
        if listeners(cast.port):
            outcome.left_behind.append(f"a socket that listens on port {cast.port}")
        outcome.left_behind += [str(path) for path in sorted(self._shared) if path.exists()]
        result = read_object(cast.run_dir / "result.json")
        outcome.status = str(result.get("status", ""))
        outcome.sha256 = str(result.get("parameters_sha256", ""))
        outcome.exact = bool(result.get("exact"))
        outcome.iterations = int(str(result.get("iterations", 0)))
        outcome.steps = int(str(result.get("env_steps", 0)))
        outcome.restarts = int(str(result.get("restarts", 0)))
        outcome.growth = self._series.growth()
        with contextlib.suppress(OSError):
            outcome.median = median_seconds(cast.run_dir)


def _end_of(file: Path, lines: int = 4) -> str:
    """The last lines of a file; nothing if there is none."""
    with contextlib.suppress(OSError):
        return " | ".join(file.read_text(errors="replace").splitlines()[-lines:])
    return ""


def _command_of(pid: int) -> str:
    with contextlib.suppress(OSError):
        return Path(f"/proc/{pid}/cmdline").read_text().replace("\0", " ").strip()
    return "ended just now"
