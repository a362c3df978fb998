"""The two ends of the wire, as the loops see them.

A link gives one event at a time and never calls back. Silence is a value: `receive` returns None
when nothing came within the time given.
"""

from dataclasses import dataclass
from typing import Protocol

from dppo.wire.messages import ToLearner, ToWorker


@dataclass(frozen=True, slots=True)
class WorkerLost:
    """A worker's connection is gone."""

    worker: str


@dataclass(frozen=True, slots=True)
class LearnerLost:
    """The connection to the learner is gone."""


@dataclass(frozen=True, slots=True)
class Refused:
    """Something arrived that is not a message of ours, or was damaged on the way.

    What it may have been is lost; who waits for it gives its sender up in the end.
    """

    reason: str


class LearnerLink(Protocol):
    """The learner's end."""

    def receive(self, timeout: float) -> ToLearner | WorkerLost | Refused | None:
        """The next event, or None after `timeout` seconds."""
        ...

    def send(self, worker: str, message: ToWorker) -> None:
        """Hand over a message; it is lost if the worker is."""
        ...

    def cut(self, worker: str) -> None:
        """Let go of the connection to a worker that was given up."""
        ...

    def close(self) -> None:
        """Let go of everything, within a bound."""
        ...


class WorkerLink(Protocol):
    """A worker's end."""

    def receive(self, timeout: float) -> ToWorker | LearnerLost | Refused | None:
        """The next event, or None after `timeout` seconds."""
        ...

    def send(self, *messages: ToLearner) -> None:
        """Hand over messages, from any thread; they are lost if the learner is.

        What is ready together is better sent together: the learner is woken once.
        """
        ...

    def close(self) -> None:
        """Let go of everything, within a bound."""
        ...
