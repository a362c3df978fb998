"""Tells a worker that stalls from one that is only slow. A state machine without clock or socket.

Twice a second a worker says how much it has done (`Alive`). A worker that owes an answer stalls
when nothing is heard of it for longer than usual (its process is stopped, or its messages do not
arrive), or when it lives but its count stands still for longer than usual (its environment hangs).
"""

from collections.abc import Iterable
from dataclasses import dataclass, field

from dppo.patience import Patience

_MOSTLY = 0.9
"""A silence is most of a standstill, unless signs of life came in it: two come in a second."""
_AGAIN = 2.0
"""What ended well once may take so many times as long."""
_FORGOTTEN = 0.999
"""Share of it that is remembered when the next question has been answered."""


@dataclass(slots=True)
class _Signs:
    done: int
    moved: float
    heard: float


@dataclass(slots=True)
class Watch:
    """The workers' signs of life; `now` is any clock that only counts while we listen [s]."""

    patience: Patience
    """With a worker that lives and makes no progress."""
    pulse: Patience
    """With a worker of which nothing is heard."""
    is_new: bool = False
    """A kind of task that nobody has done yet is waited for as long as at first."""
    _signs: dict[str, _Signs] = field(default_factory=dict)
    _longest_still: float = 0.0
    _longest_silent: float = 0.0
    """Longest times that ended well, slowly forgotten: what took so long may do so again [s]."""

    def hear(self, worker: str, now: float, done: int | None = None) -> None:
        """Something came from a worker: an answer, or the count of what it has done."""
        signs = self._of(worker, now)
        self._longest_silent = max(self._longest_silent, now - signs.heard)
        if done is not None:
            self.pulse.note(now - signs.heard)
        signs.heard = now
        if done == signs.done:
            return
        self._longest_still = max(self._longest_still, now - signs.moved)
        if done is not None:
            self.patience.note(now - signs.moved)
            signs.done = done
        signs.moved = now

    def _of(self, worker: str, now: float) -> _Signs:
        """A worker's signs; of one that is new, as if it had just been heard."""
        return self._signs.setdefault(worker, _Signs(-1, now, now))

    def forget(self, worker: str) -> None:
        """A worker is gone."""
        self._signs.pop(worker, None)

    def look(self, now: float, owing: Iterable[str]) -> list[str]:
        """Who stalls, of those that owe an answer; nobody can stall who owes none."""
        busy = set(owing)
        for worker, signs in self._signs.items():
            if worker not in busy:
                signs.moved = signs.heard = now
        stalled = sorted(worker for worker in busy if self._stalls(worker, now))
        if stalled:
            self.patience.double()
            self.pulse.double()
        return stalled

    def calm(self) -> None:
        """A question was answered, nobody is waited for any more: as patient as before."""
        self.patience.calm()
        self.pulse.calm()
        self._longest_still *= _FORGOTTEN
        self._longest_silent *= _FORGOTTEN

    def _stalls(self, worker: str, now: float) -> bool:
        signs = self._of(worker, now)
        still = max(self.patience.limit, _AGAIN * self._longest_still)
        if self.is_new:
            still = max(still, self.patience.first)
        silent = max(self.pulse.limit, _AGAIN * self._longest_silent)
        return now - signs.heard > silent or now - signs.moved > still

    def describe(self, worker: str, now: float) -> str:
        """A silence in words: is the process quiet, or does it live and hang?"""
        signs = self._of(worker, now)
        if now - signs.heard > _MOSTLY * (now - signs.moved):
            return f"silent for {now - signs.heard:.1f} s"
        return f"alive but without progress for {now - signs.moved:.1f} s"
