"""The queue behind a link: frames and losses in, messages out."""

import queue
from typing import Any

from dppo.errors import WireError
from dppo.wire.codec import Frame, decode
from dppo.wire.links import LearnerLost, Refused, WorkerLost

Inbox = queue.SimpleQueue[Frame | WorkerLost | LearnerLost | Refused]


def next_event(inbox: Inbox, timeout: float) -> Any:  # noqa: ANN401  the link's end narrows it
    """The next message, loss or refusal; None after `timeout` seconds of silence."""
    try:
        item = inbox.get(timeout=timeout) if timeout > 0 else inbox.get_nowait()
    except queue.Empty:
        return None
    return decoded(item) if isinstance(item, Frame) else item


def decoded(frame: Frame) -> Any:  # noqa: ANN401  the link's end narrows it
    """The message of a frame, or why it is none."""
    try:
        return decode(frame)
    except WireError as error:
        return Refused(str(error))
