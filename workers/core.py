"""A core of its own for a worker, for as long as nobody else wants it."""

import contextlib
import os
import time
from collections.abc import Callable
from typing import TypeVar

from dppo.backoff import Backoff

_LOOK_SECONDS = 0.5
"""Of work, after which it is asked whether the core was shared."""
_ALONE = 0.75
"""A thread that computes for this share of its work has the core to itself; beside another program
it is half."""
_FIRST_WAIT, _LONGEST_WAIT = 10.0, 600.0
"""Before it tries again; the first half of it at least [s]."""
_AWAKE_SECONDS = 0.002
"""Longer than the learner takes for an update."""

Found = TypeVar("Found")


class Core:
    """A context manager around work: keeps its thread on one core while nobody else is there.

    The learner wakes up on whichever core is free, and a worker that is asked meanwhile goes to
    another one: workers change places again and again, each time to a cold cache. But beside
    another program one that cannot move is slower than one that can. Bits do not depend on it.

    Only the thread that works is kept, and only after half a second of work: what it has started
    until then, or right after `release`, such as an environment's own threads, may use all cores.
    If somebody else gives this thread other cores, it is left alone from then on.
    """

    def __init__(
        self,
        number: int = -1,
        clock: Callable[[], float] = time.monotonic,
        computed: Callable[[], float] = time.thread_time,
    ) -> None:
        """Nothing is kept yet.

        Args:
            number: of the core among those that this process may use; -1: it may use all.
            clock: seconds since some moment.
            computed: seconds that the calling thread has spent on a core.
        """
        self._clock, self._computed = clock, computed
        self._all = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set[int]()
        self._own = set(sorted(self._all)[number : number + 1]) if number >= 0 else set[int]()
        self._pauses, self._again = Backoff(_FIRST_WAIT, _LONGEST_WAIT), clock()
        self._keeps = False
        self._worked = self._alone = 0.0
        """Seconds since the last look: of work, and of these on a core."""
        self._begun = self._before = 0.0

    def __enter__(self) -> None:
        """Work begins."""
        self._begun, self._before = self._clock(), self._computed()

    def __exit__(self, *_error: object) -> None:
        """It is done."""
        self._worked += self._clock() - self._begun
        self._alone += self._computed() - self._before
        if self._own and self._worked >= _LOOK_SECONDS:
            self._look(is_alone=self._alone >= _ALONE * self._worked)
            self._worked = self._alone = 0.0

    def release(self) -> None:
        """Go anywhere until after the next half second of work."""
        if self._keeps:
            self._keep(False)
        self._begun, self._before = self._clock(), self._computed()
        self._worked = self._alone = 0.0

    def awake(self, look: Callable[[], Found | None]) -> Found | None:
        """What `look` finds within a moment, without going to sleep; None: nothing, or not alone.

        To wake a core that sleeps takes as long as a tenth of an update. The learner gets this
        core at once when it wants it.
        """
        until = self._clock() + _AWAKE_SECONDS
        while self._keeps and self._clock() < until:
            if (found := look()) is not None:
                return found
            os.sched_yield()
        return None

    def _look(self, *, is_alone: bool) -> None:
        if self._keeps and is_alone:
            self._pauses.again()
        elif self._keeps:
            self._keep(False)
            self._again = self._clock() + self._pauses.next()
        elif self._clock() >= self._again:
            self._keep(True)

    def _keep(self, keeps: bool) -> None:
        if os.sched_getaffinity(0) != (self._own if self._keeps else self._all):
            self._own, self._keeps = set(), False  # somebody else decides
            return
        with contextlib.suppress(OSError):  # the cores were taken away meanwhile
            os.sched_setaffinity(0, self._own if keeps else self._all)
            self._keeps = keeps
