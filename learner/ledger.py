"""The ledger of a run under way: notes each update and iteration, or compares it in a replay."""

import logging
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from dppo.config import RolloutConfig
from dppo.deadlines import Deadlines
from dppo.rounds import Round
from dppo.store.checkpoint import sha256
from dppo.store.ledger import IterationLine, LateLine, Line, UpdateLine
from dppo.wire.messages import Answer, Collected
from learner.dropping import RECENT, STARVES_BELOW, Accounts
from learner.replay import Original

log = logging.getLogger("learner")
_SHORT = 16


class Ledger:
    """Which slots each update went on without, and hashes of what came out."""

    def __init__(
        self,
        config: RolloutConfig,
        write: Callable[[Line], None],
        deadlines: Deadlines | None = None,
        accounts: Accounts | None = None,
        original: Original | None = None,
    ) -> None:
        """`accounts`: of a run that is resumed. `original`: what a replay repeats."""
        self._config, self._write, self._original = config, write, original
        self._deadlines = deadlines
        self.accounts = accounts or Accounts(config.slots)

    def slots(self, iteration: int, update: int) -> tuple[int, ...]:
        """Whom an update asks: all slots; in a replay, those that the original went on with."""
        if self._original is None:
            return tuple(range(self._config.slots))
        return self._original.slots(iteration, update)

    def updated(self, gradients: Round[Answer], parameters: NDArray[np.float32]) -> int:
        """An update is made; how many slots it went on without."""
        if self._config.drop == 0:
            return 0  # nothing to note, and no hash to spend time on
        asked = set(gradients.slots) - set(gradients.missing)
        dropped = tuple(slot for slot in range(self._config.slots) if slot not in asked)
        self._note_late()
        self._note(
            UpdateLine(
                iteration=gradients.id.iteration,
                update=gradients.id.round - 1,
                dropped=dropped,
                waited=round(gradients.waited, 6),
                parameters=sha256(parameters)[:_SHORT],
            )
        )
        return len(dropped)

    def iterated(
        self, iteration: int, parameters: NDArray[np.float32], collected: list[Collected]
    ) -> None:
        """An iteration is finished."""
        self._note_late()
        dropping = self._config.drop > 0
        episodes = [answer.episodes.reshape(-1, 2) for answer in collected] if dropping else []
        returns, lengths = (
            tuple(float(each[:, column].mean()) if len(each) else None for each in episodes)
            for column in (0, 1)
        )
        self._note(
            IterationLine(
                iteration=iteration,
                parameters_sha256=sha256(parameters),
                returns=returns,
                lengths=lengths,
            )
        )

    def _note_late(self) -> None:
        for late in [] if self._deadlines is None else self._deadlines.take_late():
            self._note(
                LateLine(
                    iteration=late.id.iteration,
                    update=late.id.round - 1,
                    late=late.slot,
                    by=round(late.by, 6),
                )
            )

    def _note(self, line: Line) -> None:
        self._write(line)
        for slot in self.accounts.note(line):
            log.warning(
                "slot %d is in fewer than %.0f %% of the last %d updates: its worker is too slow "
                "for --drop %d; give it less to do, or lower --drop",
                slot,
                100 * STARVES_BELOW,
                RECENT,
                self._config.drop,
            )
        if self._original is not None:
            self._original.compare(line)
