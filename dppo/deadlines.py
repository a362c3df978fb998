"""How long an update waits for all slots before it goes on without the late ones.

A state machine without a clock: times are passed in. The deadline adapts to how long slots took to
answer lately, so that a gradient that is nearly finished is still taken. Late answers count, too,
with how long they took. A slot that was dropped `drop_limit` times running is waited for.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

from dppo.patience import WINDOW, Patience
from dppo.rounds import Round, RoundId
from dppo.sums import Block, members

Answer = TypeVar("Answer")
_FIRST_SECONDS = 30.0
_LEAST_SECONDS = 0.001
"""Below this, messages' ways through the machine decide who is late."""
_WINDOW_UPDATES = 4
"""All slots of so many updates are within the window, even if there are many slots."""


@dataclass(frozen=True, slots=True)
class Late:
    """An answer that came after its round had closed."""

    id: RoundId
    slot: int
    by: float
    """How long after [s]."""


@dataclass(slots=True)
class _Asked:
    """One round's question, and who has not answered it."""

    opened: float
    missing: set[int]
    closed: float = math.inf


class Deadlines:
    """Of the rounds that may close without some slots.

    Example:
        deadlines = Deadlines(slots=8, drop_limit=3)
        deadlines.open(round, now=10.0)  # 40.0: nothing is known yet
        deadlines.answered(round.id, (0, 4), now=10.1)
        deadlines.close(round, now=10.2)
    """

    def __init__(self, slots: int, drop_limit: int, first: float = _FIRST_SECONDS) -> None:
        """With a `drop_limit` of 0 no slot is ever dropped; `first`: see `Patience`."""
        self._drop_limit = drop_limit
        self.running = dict.fromkeys(range(slots), 0)
        """Slot to the number of updates running that went on without it."""
        self._patience = Patience(
            first=first,
            least=_LEAST_SECONDS,
            window=max(WINDOW, _WINDOW_UPDATES * slots),
        )
        self._asked: dict[RoundId, _Asked] = {}
        self._late: list[Late] = []

    def resume(self, running: Sequence[int]) -> None:
        """Of each slot, the updates running that an earlier learner went on without it."""
        self.running = dict(enumerate(running))

    def open(self, round_: Round[Answer], now: float) -> float:
        """All slots are asked; until when to wait for all of them, infinity: for ever."""
        if round_.quorum >= len(round_.missing):
            return math.inf
        self._forget_all_but(round_.id.iteration)
        round_.required = frozenset(
            slot for slot, times in self.running.items() if times >= self._drop_limit
        )
        self._asked[round_.id] = _Asked(now, set(round_.missing))
        return now + self._patience.limit

    def answered(self, round_id: RoundId, block: Block, now: float) -> None:
        """An answer has come, in time or not; only the first one of a slot says something."""
        asked = self._asked.get(round_id)
        if asked is None:
            return
        for slot in asked.missing.intersection(members(block)):
            self._patience.note(now - asked.opened)
            if now >= asked.closed:
                self._late.append(Late(round_id, slot, now - asked.closed))
        asked.missing.difference_update(members(block))

    def close(self, round_: Round[Answer], now: float) -> None:
        """The update goes on with what is in."""
        asked = self._asked.get(round_.id)
        if asked is None:
            return
        asked.closed, round_.waited = now, now - asked.opened
        dropped = set(round_.missing)
        for slot, times in self.running.items():
            self.running[slot] = times + 1 if slot in dropped else 0

    def take_late(self) -> list[Late]:
        """The late answers since this was last asked."""
        late, self._late = self._late, []
        return sorted(late, key=lambda each: (each.id, each.slot))

    def _forget_all_but(self, iteration: int) -> None:
        """Whoever is in the present iteration has answered what went before, or is lost."""
        done = [each for each in self._asked if each.iteration != iteration]
        for round_id in done:
            del self._asked[round_id]
