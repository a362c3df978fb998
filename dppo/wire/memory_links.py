"""Both ends on queues in one process, through the same codec: for tests and debugging."""

import queue
from dataclasses import dataclass, field

from dppo.wire.codec import encode
from dppo.wire.inbox import Inbox, next_event
from dppo.wire.links import LearnerLost, Refused, WorkerLost
from dppo.wire.messages import ToLearner, ToWorker


@dataclass(slots=True)
class MemoryHub:
    """Where the ends meet: `hub.learner()` once, `hub.worker(name)` for each worker."""

    _to_learner: Inbox = field(default_factory=queue.SimpleQueue)
    _to_workers: dict[str, Inbox] = field(default_factory=dict)

    def learner(self) -> "MemoryLearnerLink":
        """The learner's end."""
        return MemoryLearnerLink(self._to_learner, self._to_workers)

    def worker(self, name: str) -> "MemoryWorkerLink":
        """One worker's end."""
        inbox: Inbox = queue.SimpleQueue()
        self._to_workers[name] = inbox
        return MemoryWorkerLink(name, inbox, self)

    def lose(self, name: str) -> None:
        """The worker's connection breaks: both ends are told."""
        inbox = self._to_workers.pop(name, None)
        if inbox is not None:
            inbox.put(LearnerLost())
            self._to_learner.put(WorkerLost(name))

    def to_learner(self, message: ToLearner) -> None:
        """A worker's message, on its way."""
        self._to_learner.put(encode(message))


@dataclass(slots=True)
class MemoryLearnerLink:
    """A `LearnerLink`."""

    _inbox: Inbox
    _workers: dict[str, Inbox]

    def receive(self, timeout: float) -> ToLearner | WorkerLost | Refused | None:
        """See `LearnerLink`."""
        event: ToLearner | WorkerLost | Refused | None = next_event(self._inbox, timeout)
        return event

    def send(self, worker: str, message: ToWorker) -> None:
        """See `LearnerLink`."""
        if worker in self._workers:
            self._workers[worker].put(encode(message))

    def cut(self, worker: str) -> None:
        """See `LearnerLink`. A queue is no connection."""

    def close(self) -> None:
        """See `LearnerLink`."""
        for inbox in self._workers.values():
            inbox.put(LearnerLost())


@dataclass(slots=True)
class MemoryWorkerLink:
    """A `WorkerLink`."""

    _name: str
    _inbox: Inbox
    _hub: MemoryHub

    def receive(self, timeout: float) -> ToWorker | LearnerLost | Refused | None:
        """See `WorkerLink`."""
        event: ToWorker | LearnerLost | Refused | None = next_event(self._inbox, timeout)
        return event

    def send(self, *messages: ToLearner) -> None:
        """See `WorkerLink`."""
        for message in messages:
            self._hub.to_learner(message)

    def close(self) -> None:
        """See `WorkerLink`."""
        self._hub.lose(self._name)
