"""The end of a run, for workers that an earlier learner has not told of it any more."""

import time

from dppo.wire.links import LearnerLink
from dppo.wire.messages import Hello, Stop

_SECONDS = 5.0
"""A worker says Hello every two seconds; to connect again takes about as long."""


def dismiss(link: LearnerLink, reason: str) -> None:
    """Tell everybody who says Hello within a moment that the run is over."""
    until = time.monotonic() + _SECONDS
    while (left := until - time.monotonic()) > 0:
        event = link.receive(left)
        if isinstance(event, Hello):
            link.send(event.worker, Stop(reason=reason, final=True))
