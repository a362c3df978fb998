"""A worker whose every tenth gradient is a lie: finite, of the right length, and 1e30 large."""

import logging
import sys
from dataclasses import replace

import numpy as np

from dppo.machine import one_thread
from dppo.process import leave, start_logging

one_thread()

from dppo.wire.messages import Gradient, ToLearner  # noqa: E402  after the threads
from dppo.wire.zenoh_links import ZenohWorkerLink, open_connecting  # noqa: E402
from workers.membership import Member, wait_for  # noqa: E402

TRUE_ONES_BEFORE = 9


class LyingLink(ZenohWorkerLink):
    """Says what the worker says, and now and then something else."""

    told = 0

    def send(self, *messages: ToLearner) -> None:
        """See `WorkerLink`."""
        super().send(*map(self._told, messages))

    def _told(self, message: ToLearner) -> ToLearner:
        if isinstance(message, Gradient):
            self.told += 1
            if self.told % (TRUE_ONES_BEFORE + 1) == 0:
                return replace(message, vector=np.full_like(message.vector, 1e30))
        return message


def work(address: str) -> int:
    """Serve one run."""

    def connect() -> LyingLink | None:
        session = open_connecting(address)
        return None if session is None else LyingLink(session, "liar")

    stop = Member("liar", wait_for(connect, address, 60.0), 60.0).live()
    logging.getLogger("worker").info("%s", stop.reason)
    return 0


if __name__ == "__main__":
    start_logging(verbose=True)
    leave(lambda: work(sys.argv[1]))
