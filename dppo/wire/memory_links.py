"""Both ends on queues in one process, through the same codec: for tests and debugging."""

import queue
from dataclasses import dataclass, field

from dppo.wire.codec import Frame, decode, encode
from dppo.wire.links import LearnerLost, WorkerLost
from dppo.wire.messages import ToLearner, ToWorker

_Inbox = queue.SimpleQueue[Frame | WorkerLost | LearnerLost]


@dataclass(slots=True)
class MemoryHub:
    """Where the ends meet: `hub.learner()` once, `hub.worker(name)` for each worker."""

    _to_learner: _Inbox = field(default_factory=queue.SimpleQueue)
    _to_workers: dict[str, _Inbox] = field(default_factory=dict)

    def learner(self) -> "MemoryLearnerLink":
        """The learner's end."""
        return MemoryLearnerLink(self._to_learner, self._to_workers)

    def worker(self, name: str) -> "MemoryWorkerLink":
        """One worker's end."""
        inbox: _Inbox = queue.SimpleQueue()
        self._to_workers[name] = inbox
        return MemoryWorkerLink(inbox, self._to_learner)

    def lose(self, name: str) -> None:
        """The worker's connection breaks: both ends are told."""
        self._to_workers.pop(name).put(LearnerLost())
        self._to_learner.put(WorkerLost(name))


def _next(inbox: _Inbox, timeout: float) -> Frame | WorkerLost | LearnerLost | None:
    try:
        return inbox.get(timeout=timeout) if timeout > 0 else inbox.get_nowait()
    except queue.Empty:
        return None


@dataclass(slots=True)
class MemoryLearnerLink:
    """A `LearnerLink`."""

    _inbox: _Inbox
    _workers: dict[str, _Inbox]

    def receive(self, timeout: float) -> ToLearner | WorkerLost | None:
        """See `LearnerLink`."""
        event = _next(self._inbox, timeout)
        return decode(event) if isinstance(event, Frame) else event  # type: ignore[return-value]

    def send(self, worker: str, message: ToWorker) -> None:
        """See `LearnerLink`."""
        if worker in self._workers:
            self._workers[worker].put(encode(message))

    def close(self) -> None:
        """See `LearnerLink`."""
        for inbox in self._workers.values():
            inbox.put(LearnerLost())


@dataclass(slots=True)
class MemoryWorkerLink:
    """A `WorkerLink`."""

    _inbox: _Inbox
    _to_learner: _Inbox

    def receive(self, timeout: float) -> ToWorker | LearnerLost | None:
        """See `WorkerLink`."""
        event = _next(self._inbox, timeout)
        return decode(event) if isinstance(event, Frame) else event  # type: ignore[return-value]

    def send(self, message: ToLearner) -> None:
        """See `WorkerLink`."""
        self._to_learner.put(encode(message))

    def close(self) -> None:
        """See `WorkerLink`."""
