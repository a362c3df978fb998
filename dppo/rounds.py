"""One round: the chief asks every slot for something and gathers the answers.

A state machine without clock or socket. It is fed with what arrives and says what that was; it
says who is missing and whether enough are in (Heess et al., Algorithm 2: "wait until at least
W - D gradients are available"). How long it waits for the others is in `deadlines.py`.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Generic, Literal, TypeVar

from dppo.sums import Block, members

Answer = TypeVar("Answer")
Verdict = Literal["taken", "stale", "repeated"]


@dataclass(frozen=True, slots=True, order=True)
class RoundId:
    """Names one round of one run; answers carry it."""

    generation: int
    """Incarnation of the learner: +1 at every start on the same run directory."""
    iteration: int
    round: int
    """0 collect, 1 + u update u, 1 + updates: measure."""


@dataclass(slots=True)
class Round(Generic[Answer]):
    """The answers to one question.

    Example:
        round = Round(RoundId(1, 0, 3), range(8), quorum=7)
        round.offer(RoundId(1, 0, 3), (0, 4), vector)  # "taken"
    """

    id: RoundId
    slots: Iterable[int]
    quorum: int
    """Slots that must be in before the round may close."""
    answers: dict[Block, Answer] = field(default_factory=dict)
    required: frozenset[int] = frozenset()
    """Slots that must be among those that are in, whatever the quorum."""
    overdue: bool = False
    """The time that it waits for all is over."""
    waited: float = 0.0
    """How long it took until it closed [s]."""
    _missing: set[int] = field(init=False)

    def __post_init__(self) -> None:
        """Everyone is missing at first."""
        self._missing = set(self.slots)

    def offer(self, round_id: RoundId, block: Block, answer: Answer) -> Verdict:
        """Take one answer. A block that repeats a slot is ignored whole: none counts twice."""
        if round_id != self.id:
            return "stale"
        if not self._missing.issuperset(members(block)):
            return "repeated"
        self.answers[block] = answer
        self._missing.difference_update(members(block))
        return "taken"

    @property
    def missing(self) -> tuple[int, ...]:
        """Slots without an answer, in order."""
        return tuple(sorted(self._missing))

    @property
    def may_close(self) -> bool:
        """All slots are in; or it is overdue, and the required ones and the quorum are in."""
        if not self._missing:
            return True
        enough = sum(size for _, size in self.answers) >= self.quorum
        return self.overdue and enough and self._missing.isdisjoint(self.required)
