"""Checkpoints beside the training: a disk that fails or is slow costs checkpoints, not the run."""

import contextlib
import errno
import logging
import time
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path
from typing import Any

from dppo.errors import RunFailedError
from dppo.store.checkpoint import mark_best, name_of, prune, save_checkpoint
from learner.disk import Disk
from learner.state import State

log = logging.getLogger("checkpoint")
_PAUSES = (0.1, 0.3, 0.9)
"""Between attempts [s]: together well within the grace that a stopped container gets."""
Pause = Callable[[float], None]


def insist(work: Callable[[], None], pause: Pause = time.sleep) -> OSError | None:
    """Do `work`, again after pauses if the disk fails; the last error if it never works."""
    for seconds in _PAUSES:
        try:
            work()
        except OSError:
            pause(seconds)
        else:
            return None
    try:
        work()
    except OSError as error:
        return error
    return None


class Saving:
    """Saves states as checkpoints, in the disk's thread, one at a time."""

    def __init__(
        self,
        disk: Disk,
        folder: Path,
        keep: int,
        facts: Callable[[State], dict[str, Any]],
        pause: Pause = time.sleep,
    ) -> None:
        """`facts` are what a checkpoint holds besides the state."""
        self._disk, self._folder, self._keep = disk, folder, keep
        self._facts, self._pause = facts, pause
        self._newest = -1
        self._best_mean = float("-inf")
        self._job: Future[None] | None = None
        self._failure: OSError | None = None
        self._is_trying_again = False
        self._was_slow = False

    def resumed(self, state: State) -> None:
        """The run goes on from this state's checkpoint; it may have been the best, unmarked."""
        self._newest, self._best_mean = state.iteration, state.best_mean
        if len(state.episodes) and state.mean_return == state.best_mean:
            name = name_of(state.iteration)
            self._disk.run(lambda: self._mark(name, state.best_mean))

    def unsaved(self, iteration: int) -> int:
        """Iterations that a crash at the start of `iteration` would cost."""
        return iteration - max(self._newest, 0)

    def begin(self, state: State) -> None:
        """Save beside the training, unless the last one is still being written; never waits."""
        if self._job is not None and not self._job.done():
            if not self._was_slow and self._failure is None and not self._is_trying_again:
                self._was_slow = True
                log.warning(
                    "the disk is slow: the checkpoint of iteration %d is left out, the one before "
                    "it is still being written; this is said once",
                    state.iteration,
                )
            return
        self._settle()
        self._job = self._disk.run(lambda: self._save(state))

    def finish(
        self,
        state: State,
        most: float = float("inf"),
        look_after: Callable[[], None] = lambda: None,
    ) -> None:
        """Make sure that the state is on the disk.

        Args:
            state: what has to be there.
            most: longest wait [s].
            look_after: called while it waits; it may raise.

        Raises:
            RunFailedError: it cannot be written, or not in time.
        """
        try:
            self._settle(most, look_after)
            if self._newest != state.iteration:
                self._job = self._disk.run(lambda: self._save(state, last=True))
                self._settle(most, look_after)
        except OSError as error:
            self._failure = error
        if self._newest != state.iteration:
            raise RunFailedError(
                f"the checkpoint of iteration {state.iteration} in {self._folder} could not be "
                f"written: {self._failure}; make room there and start the same command again, it "
                f"goes on from iteration {max(self._newest, 0)}"
            )

    def _settle(
        self, most: float = float("inf"), look_after: Callable[[], None] = lambda: None
    ) -> None:
        """Wait for the save under way; an error that is not the disk's is raised here."""
        if self._job is not None:
            self._disk.wait(self._job, f"a checkpoint in {self._folder}", most, look_after)
            self._job = None

    def _save(self, state: State, last: bool = False) -> None:
        """In the disk's thread: all attempts to save one state."""
        failure = insist(lambda: self._write(state), self._pause_between)
        self._is_trying_again = False
        before, self._failure = self._failure, failure
        if failure is None and before is not None:
            log.warning("checkpoints are written again, up to iteration %d", state.iteration)
        if failure is not None and before is None and not last:
            log.warning(
                "the checkpoint of iteration %d in %s cannot be written: %s; training goes on and "
                "tries again at the next checkpoint%s",
                state.iteration,
                self._folder,
                failure,
                _advice(failure),
            )

    def _pause_between(self, seconds: float) -> None:
        self._is_trying_again = True
        self._pause(seconds)

    def _write(self, state: State) -> None:
        self._disk.write_out()  # the lines of the iterations that the checkpoint is beyond
        name = name_of(state.iteration)
        mean = state.mean_return
        judged = replace(state, best_mean=max(mean, self._best_mean))
        save_checkpoint(self._folder, name, judged.to_checkpoint(self._facts(state)))
        self._newest = state.iteration
        if len(state.episodes) and mean >= self._best_mean:
            mark_best(self._folder, name, mean)
        self._best_mean = judged.best_mean
        prune(self._folder, self._keep)

    def _mark(self, name: str, mean: float) -> None:
        with contextlib.suppress(OSError):  # a disk that fails is told of at the next checkpoint
            mark_best(self._folder, name, mean)


def _advice(failure: OSError) -> str:
    full = failure.errno in (errno.ENOSPC, errno.EDQUOT)
    return "; make room there" if full else "; see to the disk"
