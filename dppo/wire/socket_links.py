"""Both ends on a pair of connected sockets: the learner and the workers it has started itself.

Between processes of one host a frame takes one write and one read; through Zenoh it passes half a
dozen threads (docs/performance.md). Nothing has a name, so nothing is left behind, and either
process sees at once when the other is gone. A worker that is only stopped is noticed by who
started it (`learner/local.py`).
"""

import contextlib
import os
import select
import socket
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from dppo.errors import WireError
from dppo.wire.channel import Channel, without
from dppo.wire.codec import Frame
from dppo.wire.inbox import decoded
from dppo.wire.links import LearnerLink, LearnerLost, Refused, WorkerLost
from dppo.wire.messages import ToLearner, ToWorker
from dppo.wire.shared_bodies import SharedBodies, new_memory

_BUFFER = 1 << 20
_MOST_PIECES = 64
_READABLE = select.POLLIN | select.POLLHUP | select.POLLERR


@dataclass(slots=True)
class _Peer:
    """The learner's end of one worker's pair."""

    channel: Channel
    unsent: list[memoryview] = field(default_factory=list)
    has_spoken: bool = False


class SocketLearnerLink:
    """A `LearnerLink` to this process's own workers, beside the link to all others."""

    def __init__(self, others: LearnerLink, alarm: "Alarm") -> None:
        """`alarm` rings when `others` has something."""
        self._others, self._alarm = others, alarm
        self._peers: dict[str, _Peer] = {}
        self._names: dict[int, str] = {}
        self._cut: set[str] = set()
        self._events: deque[ToLearner | WorkerLost | Refused] = deque()
        self._others_ready = False
        self._poll = select.poll()
        self._poll.register(alarm, select.POLLIN)

    def adopt(self, name: str) -> "Inheritance":
        """A new pair for the worker `name`: what its process has to inherit."""
        ours, theirs = socket.socketpair()
        for end in (ours, theirs):
            for option in (socket.SO_SNDBUF, socket.SO_RCVBUF):
                end.setsockopt(socket.SOL_SOCKET, option, _BUFFER)
        ours.setblocking(False)
        memory = new_memory()
        bodies = None if memory is None else SharedBodies(memory, is_learner=True)
        self._peers[name], self._names[ours.fileno()] = _Peer(Channel(ours, bodies)), name
        self._poll.register(ours, select.POLLIN)
        return Inheritance(theirs, memory)

    def receive(self, timeout: float) -> ToLearner | WorkerLost | Refused | None:
        """See `LearnerLink`."""
        deadline = time.monotonic() + timeout
        while True:
            if self._events:
                return self._events.popleft()
            if self._others_ready and (event := self._others.receive(0.0)) is not None:
                return event
            self._others_ready = False
            left = deadline - time.monotonic()
            ready = self._poll.poll(max(0.0, 1000 * left))
            for descriptor, what in ready:
                self._serve(descriptor, what)
            if not ready and left <= 0 and not self._events:
                return None

    def send(self, worker: str, message: ToWorker) -> None:
        """See `LearnerLink`. Never waits for the worker: what it does not take yet is kept."""
        peer = self._peers.get(worker)
        if peer is None:
            self._others.send(worker, message)
            return
        waiting = bool(peer.unsent)
        peer.unsent += peer.channel.pieces(message)
        if not waiting:
            self._flush(worker, peer)

    def forget(self, name: str) -> None:
        """Close the pair of a worker whose process has ended, if it is still there."""
        self._cut.discard(name)
        if name in self._peers:
            self._lose(name)

    def cut(self, worker: str) -> None:
        """See `LearnerLink`. Whoever started the worker asks `was_cut`."""
        if worker in self._peers:
            self._drop(worker)
            self._cut.add(worker)
        else:
            self._others.cut(worker)

    def was_cut(self, name: str) -> bool:
        """Was this worker given up? Its process may still be there."""
        return name in self._cut

    def has_spoken(self, name: str) -> bool:
        """Did anything come from this worker since this was last asked?"""
        peer = self._peers.get(name)
        spoken = peer is not None and peer.has_spoken
        if peer is not None:
            peer.has_spoken = False
        return spoken

    def let_go(self) -> None:
        """Close all pairs: the workers' processes end."""
        for name in list(self._peers):
            self._drop(name)

    def close(self) -> None:
        """See `LearnerLink`."""
        self.let_go()
        self._others.close()

    def _serve(self, descriptor: int, what: int) -> None:
        """Something can be read from, or written to, one of the sockets."""
        name = self._names.get(descriptor)
        if name is None:
            self._alarm.hush()
            self._others_ready = True
            return
        peer = self._peers[name]
        if what & select.POLLOUT:
            self._flush(name, peer)
        if what & _READABLE and name in self._peers:
            self._read(name, peer)

    def _read(self, name: str, peer: _Peer) -> None:
        peer.has_spoken = True
        try:
            self._events.extend(decoded(frame) for frame in peer.channel.frames())
        except WireError as error:  # out of step: nothing behind it can be read
            self._events.append(Refused(f"from worker {name}: {error}"))
            self._lose(name)
        except EOFError:
            self._lose(name)

    def _flush(self, name: str, peer: _Peer) -> None:
        """Write what the socket takes; come back for the rest when it takes more."""
        try:
            while peer.unsent:
                count = peer.channel.end.sendmsg(peer.unsent[:_MOST_PIECES])
                peer.unsent = without(peer.unsent, count)
        except BlockingIOError:
            self._poll.modify(peer.channel.end, select.POLLIN | select.POLLOUT)
        except ConnectionError:
            self._read(name, peer)  # its last words, and then the end
        else:
            self._poll.modify(peer.channel.end, select.POLLIN)

    def _lose(self, name: str) -> None:
        self._drop(name)
        self._events.append(WorkerLost(name))

    def _drop(self, name: str) -> None:
        peer = self._peers.pop(name)
        del self._names[peer.channel.end.fileno()]
        self._poll.unregister(peer.channel.end)
        peer.channel.end.close()


@dataclass(frozen=True, slots=True)
class Inheritance:
    """What a worker's process inherits: its end of the pair, and the memory if there is any."""

    end: socket.socket
    memory: int | None

    @property
    def descriptors(self) -> tuple[int, ...]:
        """For the new process, in this order."""
        return (self.end.fileno(), *(() if self.memory is None else (self.memory,)))

    def close(self) -> None:
        """Once the new process has them, this one needs them no more."""
        self.end.close()
        if self.memory is not None:
            os.close(self.memory)


class Alarm:
    """Wakes a process that waits for descriptors when something came another way."""

    def __init__(self) -> None:
        self._reading, self._writing = os.pipe()
        os.set_blocking(self._reading, False)
        os.set_blocking(self._writing, False)

    def fileno(self) -> int:
        """Readable while it rings."""
        return self._reading

    def ring(self) -> None:
        """From any thread."""
        with contextlib.suppress(BlockingIOError):  # it rings already
            os.write(self._writing, b"\0")

    def hush(self) -> None:
        """Stop ringing."""
        with contextlib.suppress(BlockingIOError):
            os.read(self._reading, 4096)


class SocketWorkerLink:
    """A `WorkerLink` to the learner that started this process."""

    def __init__(self, descriptors: Sequence[int], orphaned: Callable[[], None]) -> None:
        """Take over what was inherited.

        Args:
            descriptors: as in `Inheritance`; processes that this one starts do not get them.
            orphaned: called in another thread when the learner is gone: there is no other one to
                wait for.
        """
        for descriptor in descriptors:
            os.set_inheritable(descriptor, False)
        self._end = socket.socket(fileno=descriptors[0])
        bodies = None
        if descriptors[1:]:
            bodies = SharedBodies(descriptors[1], is_learner=False)
            os.close(descriptors[1])
        self._channel, self._frames = Channel(self._end, bodies), deque[Frame]()
        self._incoming = select.poll()
        self._incoming.register(self._end, select.POLLIN)
        self._orphaned, self._closed = orphaned, False
        self._sending = threading.Lock()
        threading.Thread(target=self._watch, daemon=True).start()

    def receive(self, timeout: float) -> ToWorker | LearnerLost | Refused | None:
        """See `WorkerLink`."""
        deadline = time.monotonic() + timeout
        while not self._frames:
            left = max(0.0, deadline - time.monotonic())
            if not self._incoming.poll(1000 * left):
                return None
            try:
                self._frames.extend(self._channel.frames())
            except EOFError:
                return LearnerLost()
            except WireError as error:  # out of step: nothing behind it can be read
                self._end.shutdown(socket.SHUT_RDWR)
                return Refused(str(error))
        message: ToWorker | Refused = decoded(self._frames.popleft())
        return message

    def send(self, *messages: ToLearner) -> None:
        """See `WorkerLink`."""
        with self._sending, contextlib.suppress(ConnectionError):
            unsent = [piece for message in messages for piece in self._channel.pieces(message)]
            while unsent:
                unsent = without(unsent, self._end.sendmsg(unsent[:_MOST_PIECES]))

    def close(self) -> None:
        """See `WorkerLink`."""
        self._closed = True
        with contextlib.suppress(OSError):
            self._end.shutdown(socket.SHUT_RDWR)  # wakes the thread that watches
        self._end.close()

    def _watch(self) -> None:
        """Wait for the other end to close, whatever the rest of this process does meanwhile."""
        hangup = select.poll()
        hangup.register(self._end, 0)
        hangup.poll()
        if not self._closed:
            self._orphaned()
