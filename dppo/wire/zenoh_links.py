"""Both ends on Zenoh. The only place that talks to the network.

The learner's session is a router that listens; workers are clients that dial out. Multicast and
gossip are off, so a worker only ever meets the learner it was told about. Settings and their
reasons: docs/protocol.md. Callbacks run in Zenoh's threads and only put into a queue.

Keys, under `dppo/v1`:

    g/<worker>        worker -> learner: every message of that worker
    p/<worker>        learner -> worker: every message to that worker
    live/w/<worker>   liveliness token of a worker
    live/learner      liveliness token of the learner
"""

import contextlib
import json
import os
import queue
import threading
import time
from collections.abc import Callable
from typing import Any

# Zenoh's default of one sending thread lets one stuck link delay all others.
os.environ.setdefault("ZENOH_RUNTIME", "(tx: (worker_threads: 4), rx: (worker_threads: 4))")

import zenoh

from dppo.errors import UsageError, WireError
from dppo.wire.addresses import check_address
from dppo.wire.codec import encode, sealed, unsealed
from dppo.wire.inbox import Inbox, next_event
from dppo.wire.links import LearnerLost, Refused, WorkerLost
from dppo.wire.messages import Hello, ToLearner, ToWorker

BASE = "dppo/v1"
_CLOSE_SECONDS = 3.0
_LOOK_SECONDS = 0.2
_DEAF_SECONDS = 5.0
"""A worker that has said Hello for so long and heard nothing opens a session anew."""


def _config(mode: str, endpoints: dict[str, Any]) -> zenoh.Config:
    return zenoh.Config.from_json5(
        json.dumps(
            {
                "mode": mode,
                **endpoints,
                "scouting": {
                    "delay": 0,
                    "multicast": {"enabled": False},
                    "gossip": {"enabled": False},
                },
                "timestamping": {"enabled": False},
                "adminspace": {"enabled": False},
                "transport": {
                    "unicast": {"accept_pending": 1000},
                    "shared_memory": {"enabled": False},
                    "link": {
                        "tx": {
                            "lease": 2000,  # ms; a silent peer is given up after this
                            "queue": {
                                "size": {"data": 16},
                                "congestion_control": {"block": {"wait_before_close": 500_000}},
                            },
                        }
                    },
                },
            }
        )
    )


def _sentence(error: zenoh.ZError) -> str:
    """Zenoh's message without the places in its source."""
    return str(error).split(" at /")[0].split("[")[0].strip().rstrip(".:")


def open_listening(address: str) -> zenoh.Session:
    """The learner's session.

    Raises:
        UsageError: the address is taken, or not one of this host.
    """
    try:
        return zenoh.open(_config("router", {"listen": {"endpoints": [address]}}))
    except zenoh.ZError as error:
        raise UsageError(
            f"cannot listen on {address}: {_sentence(error)}; give --listen a free address of "
            "this host, such as tcp/127.0.0.1:7447"
        ) from error


def open_connecting(address: str) -> zenoh.Session | None:
    """A worker's session; None if nobody listens there now.

    Raises:
        UsageError: the address is malformed.
    """
    check_address("--connect", address)
    endpoints = {
        "listen": {"endpoints": []},
        "connect": {
            "endpoints": [address],
            "timeout_ms": 0,
            "retry": {
                "period_init_ms": 100,
                "period_max_ms": 1000,
                "period_increase_factor": 1.5,
            },
        },
    }
    opened = _opened_beside(_config("client", endpoints))
    if isinstance(opened, zenoh.Session):
        return opened
    if not isinstance(opened, zenoh.ZError):
        raise opened
    if "Unable to connect" in str(opened):
        return None
    raise UsageError(
        f"cannot connect to {address}: {_sentence(opened)}; expected an address such as "
        "tcp/learner:7447"
    ) from opened


def _opened_beside(config: zenoh.Config) -> zenoh.Session | BaseException:
    """In another thread: where nobody answers it takes ten seconds, and no signal is heard."""
    outcome: queue.SimpleQueue[zenoh.Session | BaseException] = queue.SimpleQueue()

    def work() -> None:
        try:
            outcome.put(zenoh.open(config))
        except BaseException as error:  # a panic of Zenoh's, too: somebody waits for the outcome
            outcome.put(error)

    threading.Thread(target=work, daemon=True).start()
    while True:  # a signal that comes just before a wait without end is heard at its end
        with contextlib.suppress(queue.Empty):
            return outcome.get(timeout=_LOOK_SECONDS)


class _End:
    """What both ends share: a session, an inbox, publishers, and a bounded close."""

    def __init__(self, session: zenoh.Session, ring: Callable[[], None]) -> None:
        """`ring` is called in Zenoh's threads when something has arrived."""
        zenoh.init_log_from_env_or("error")
        self._session, self._ring = session, ring
        self._inbox: Inbox = queue.SimpleQueue()
        self._publishers: dict[str, zenoh.Publisher] = {}
        self._sending = threading.Lock()
        self._kept: list[object] = []  # an entity is undeclared when nobody refers to it

    def _subscribe(self, key: str, broken: Callable[[str], WorkerLost | LearnerLost]) -> None:
        """Take what arrives; what is damaged breaks the connection that `broken` names.

        What was asked or answered in it would else be waited for until patience ends.
        """

        def arrived(sample: zenoh.Sample) -> None:
            attachment = sample.attachment
            header = attachment.to_bytes() if attachment is not None else b""
            try:
                self._inbox.put(unsealed(header, sample.payload.to_bytes()))
            except WireError as error:
                self._inbox.put(Refused(str(error)))
                self._inbox.put(broken(str(sample.key_expr).rsplit("/", 1)[1]))
            self._ring()

        handler = zenoh.handlers.Callback(arrived, indirect=False)
        self._kept.append(self._session.declare_subscriber(key, handler))

    def _watch(self, key: str, lost: type[LearnerLost] | None) -> None:
        def changed(sample: zenoh.Sample) -> None:
            if sample.kind == zenoh.SampleKind.DELETE:
                name = str(sample.key_expr).rsplit("/", 1)[1]
                self._inbox.put(lost() if lost else WorkerLost(name))
                self._ring()

        handler = zenoh.handlers.Callback(changed, indirect=False)
        self._kept.append(
            self._session.liveliness().declare_subscriber(key, handler, history=True)
        )

    def _live(self, key: str) -> None:
        self._kept.append(self._session.liveliness().declare_token(key))

    def _put(self, key: str, message: ToLearner | ToWorker) -> None:
        frame = encode(message)
        with self._sending:
            if key not in self._publishers:
                self._publishers[key] = self._session.declare_publisher(
                    key, congestion_control=zenoh.CongestionControl.BLOCK
                )
            publisher = self._publishers[key]
        publisher.put(zenoh.ZBytes(frame.body), attachment=sealed(frame))

    def close(self) -> None:
        """Close the session; give up waiting for it after three seconds."""

        def close() -> None:
            with contextlib.suppress(zenoh.ZError):
                self._session.close()  # type: ignore[no-untyped-call]

        closing = threading.Thread(target=close, daemon=True)
        closing.start()
        closing.join(_CLOSE_SECONDS)


class ZenohLearnerLink(_End):
    """A `LearnerLink`."""

    def __init__(self, address: str, ring: Callable[[], None] = lambda: None) -> None:
        """`ring` is called, in another thread, when there is something to receive."""
        super().__init__(open_listening(address), ring)
        self._subscribe(f"{BASE}/g/*", WorkerLost)
        self._watch(f"{BASE}/live/w/*", None)
        self._live(f"{BASE}/live/learner")  # last: whoever sees it may talk

    def receive(self, timeout: float) -> ToLearner | WorkerLost | Refused | None:
        """See `LearnerLink`."""
        item: ToLearner | WorkerLost | Refused | None = next_event(self._inbox, timeout)
        if isinstance(item, WorkerLost):
            self._publishers.pop(f"{BASE}/p/{item.worker}", None)
        return item

    def send(self, worker: str, message: ToWorker) -> None:
        """See `LearnerLink`."""
        self._put(f"{BASE}/p/{worker}", message)

    def cut(self, worker: str) -> None:
        """See `LearnerLink`. The transport notices by itself when the connection is gone."""
        self._publishers.pop(f"{BASE}/p/{worker}", None)


class ZenohWorkerLink(_End):
    """A `WorkerLink`; `name` must be a key segment: letters, digits, `-`.

    What it tells the learner's session about itself is said once per connection. Was that damaged
    on the way, it is deaf for good, and nothing but another session helps.
    """

    def __init__(
        self,
        session: zenoh.Session,
        name: str,
        reopen: Callable[[], zenoh.Session | None] = lambda: None,
    ) -> None:
        """`reopen` opens another session to the same learner; None: not now."""
        super().__init__(session, lambda: None)
        self._name, self._reopen = name, reopen
        self._key = f"{BASE}/g/{name}"
        self._heard = time.monotonic()
        self._declare()

    def _declare(self) -> None:
        self._subscribe(f"{BASE}/p/{self._name}", lambda _name: LearnerLost())
        self._watch(f"{BASE}/live/learner", LearnerLost)
        self._live(f"{BASE}/live/w/{self._name}")

    def receive(self, timeout: float) -> ToWorker | LearnerLost | Refused | None:
        """See `WorkerLink`."""
        item: ToWorker | LearnerLost | Refused | None = next_event(self._inbox, timeout)
        if item is not None:
            self._heard = time.monotonic()
        return item

    def send(self, *messages: ToLearner) -> None:
        """See `WorkerLink`."""
        for message in messages:
            if isinstance(message, Hello) and time.monotonic() - self._heard > _DEAF_SECONDS:
                self._renew()
            self._put(self._key, message)

    def _renew(self) -> None:
        """Another session, if there is somebody to open it with."""
        session = self._reopen()
        if session is not None:
            self.close()
            self._session = session
            self._publishers.clear()
            self._kept.clear()
            self._declare()
        self._heard = time.monotonic()
