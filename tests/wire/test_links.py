"""One contract for both kinds of link, and what only the network can do wrong."""

import os
import re
import struct
import time
from contextlib import ExitStack
from functools import partial

import numpy as np
import pytest
import zenoh

from dppo.errors import UsageError
from dppo.wire.codec import Frame
from dppo.wire.links import LearnerLost, Refused, WorkerLost
from dppo.wire.memory_links import MemoryHub
from dppo.wire.messages import Hello, Measure, Stop, Welcome
from dppo.wire.socket_links import Alarm, SocketLearnerLink, SocketWorkerLink
from dppo.wire.zenoh_links import (
    BASE,
    ZenohLearnerLink,
    ZenohWorkerLink,
    open_connecting,
    open_listening,
)
from learner.arguments import listening_address
from learner.local import free_address

PATIENCE = 10.0
"""Seconds after which an event will not come any more."""
SOON = 0.05


def hello(worker, pid=1):
    return Hello(worker=worker, host="here", pid=pid, numerics="9c1e", versions="")


WELCOME = Welcome(run="r", generation=1, config="{}")


def until(link, wanted, meanwhile=lambda: None):
    """The first event that is `wanted`; `meanwhile` is done before every wait."""
    deadline = time.monotonic() + PATIENCE
    while time.monotonic() < deadline:
        meanwhile()
        event = link.receive(SOON)
        if event is not None and wanted(event):
            return event
    pytest.fail(f"no such event within {PATIENCE} s")


class Memory:
    """Both ends on queues."""

    def __init__(self):
        self.hub = MemoryHub()
        self.learner = self.hub.learner()

    def worker(self, name):
        return self.hub.worker(name)

    def junk(self, key):
        """Bytes that are no message, on a worker's or the learner's way in."""
        frame = Frame(b"junk", b"")
        kind, name = key.split("/")
        (self.hub._to_learner if kind == "g" else self.hub._to_workers[name]).put(frame)

    def close(self):
        self.learner.close()


class Network:
    """Both ends on Zenoh, on a free port of loopback."""

    def __init__(self):
        self.address = free_address()
        self.learner = ZenohLearnerLink(self.address)
        self._after = ExitStack()
        self._after.callback(self.learner.close)

    def session(self):
        session = open_connecting(self.address)
        assert session is not None
        return session

    def worker(self, name):
        link = ZenohWorkerLink(self.session(), name)
        self._after.callback(link.close)
        return link

    def junk(self, key):
        with zenoh.open(_client(self.address)) as stranger:
            stranger.put(f"{BASE}/{key}", b"junk")
            stranger.put(f"{BASE}/{key}", b"junk", attachment=b"\x93\x01\xa4Stop")

    def close(self):
        self._after.close()


class Pairs:
    """Both ends on pairs of sockets, beside a link to others on queues."""

    def __init__(self):
        self.hub, self.alarm = MemoryHub(), Alarm()
        self.learner = SocketLearnerLink(self.hub.learner(), self.alarm)
        self._workers = []

    def worker(self, name):
        inherited = self.learner.adopt(name)
        link = SocketWorkerLink([os.dup(d) for d in inherited.descriptors], lambda: None)
        inherited.close()
        self._workers.append(link)
        return link

    def junk(self, key):
        prefix = struct.pack("<IIi", 4, 0, -1)
        kind, name = key.split("/")
        ends = [worker._end for worker in self._workers]
        end = ends[0] if kind == "g" else self.learner._peers[name].channel.end
        end.sendall(prefix + b"junk")

    def close(self):
        for worker in self._workers:
            worker.close()
        self.learner.close()


def _client(address):
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", f'["{address}"]')
    config.insert_json5("scouting/multicast/enabled", "false")
    return config


@pytest.fixture(params=[Memory, Network, Pairs])
def wire(request):
    ends = request.param()
    yield ends
    ends.close()


def met(wire, name):
    """A worker's link, once each end has heard the other."""
    worker = wire.worker(name)
    until(wire.learner, lambda e: e == hello(name), lambda: worker.send(hello(name)))
    until(worker, lambda e: e == WELCOME, lambda: wire.learner.send(name, WELCOME))
    return worker


def test_messages_keep_their_order_both_ways(wire):
    worker = met(wire, "w1")
    for number in range(100, 150):
        worker.send(hello("w1", number))
        wire.learner.send("w1", Stop(reason=str(number), final=False))
    there = [until(wire.learner, lambda e: getattr(e, "pid", 0) >= 100).pid for _ in range(50)]
    back = [until(worker, lambda e: isinstance(e, Stop)).reason for _ in range(50)]
    assert there == list(range(100, 150))
    assert back == [str(number) for number in range(100, 150)]


def test_a_megabyte_arrives_whole(wire):
    worker = met(wire, "w1")
    vector = np.random.default_rng(0).standard_normal(1 << 18).astype(np.float32)
    sent = Measure(generation=1, iteration=0, round=1, slots=(0,), parameters=vector)
    wire.learner.send("w1", sent)
    found = until(worker, lambda e: isinstance(e, Measure))
    assert found.parameters.tobytes() == vector.tobytes()


def test_each_worker_gets_only_its_own_messages(wire):
    one, two = met(wire, "w1"), met(wire, "w2")
    for name in ("w1", "w2"):
        wire.learner.send(name, Stop(reason=f"for {name}", final=True))
    assert until(one, lambda e: isinstance(e, Stop)).reason == "for w1"
    assert until(two, lambda e: isinstance(e, Stop)).reason == "for w2"


def test_silence_is_none(wire):
    for link in (met(wire, "w1"), wire.learner):
        while link.receive(SOON) is not None:
            pass  # what the handshake has said twice
        assert link.receive(0.0) is None
        assert link.receive(0.01) is None


def test_the_learner_is_told_when_a_worker_closes(wire):
    met(wire, "w2")
    met(wire, "w1").close()
    lost = until(wire.learner, lambda e: isinstance(e, WorkerLost))
    assert lost == WorkerLost("w1")


def test_every_worker_is_told_when_the_learner_closes(wire):
    one, two = met(wire, "w1"), met(wire, "w2")
    wire.learner.close()
    for worker in (one, two):
        assert until(worker, lambda e: isinstance(e, LearnerLost)) == LearnerLost()


def test_a_message_to_nobody_is_lost_without_a_word(wire):
    worker = met(wire, "w1")
    wire.learner.send("stranger", WELCOME)
    wire.learner.send("w1", Stop(reason="still here", final=False))
    assert until(worker, lambda e: isinstance(e, Stop)).reason == "still here"


def test_garbage_for_the_learner_arrives_as_refused(wire):
    met(wire, "w1")
    wire.junk("g/x")
    refused = until(wire.learner, lambda e: isinstance(e, Refused))
    assert re.search("a header is not|do not match their checksum", refused.reason)


def test_garbage_for_a_worker_arrives_as_refused(wire):
    worker = met(wire, "w1")
    wire.junk("p/w1")
    refused = until(worker, lambda e: isinstance(e, Refused))
    assert re.search("a header is not|do not match their checksum", refused.reason)


def test_what_is_damaged_on_the_network_breaks_the_connection_it_came_by():
    network = Network()
    worker = met(network, "w1")
    network.junk("g/w1")
    assert until(network.learner, lambda e: isinstance(e, WorkerLost)) == WorkerLost("w1")
    network.junk("p/w1")
    assert until(worker, lambda e: isinstance(e, LearnerLost)) == LearnerLost()
    network.close()


def test_a_worker_that_says_hello_and_hears_nothing_opens_another_session():
    network, opened = Network(), []

    def reopen():
        opened.append(network.session())
        return opened[-1]

    link = ZenohWorkerLink(network.session(), "w1", reopen)
    link._heard -= 60.0  # nothing was heard for a minute
    link.send(hello("w1"))
    assert len(opened) == 1
    until(network.learner, lambda e: e == hello("w1", 2), lambda: link.send(hello("w1", 2)))
    until(link, lambda e: e == WELCOME, lambda: network.learner.send("w1", WELCOME))
    assert len(opened) == 1
    link.close()
    network.close()


def test_a_link_works_on_after_garbage(wire):
    worker = met(wire, "w1")
    wire.junk("g/x")
    until(wire.learner, lambda e: isinstance(e, Refused))
    until(wire.learner, lambda e: e == hello("w1", 5), lambda: worker.send(hello("w1", 5)))


def test_a_broken_memory_connection_is_told_to_both_ends():
    hub = MemoryHub()
    learner, worker = hub.learner(), hub.worker("w1")
    hub.lose("w1")
    assert learner.receive(0.0) == WorkerLost("w1")
    assert worker.receive(0.0) == LearnerLost()


def test_an_address_in_use_is_refused_with_a_sentence():
    network = Network()
    with pytest.raises(UsageError, match=f"cannot listen on {network.address}: .*give --listen a"):
        open_listening(network.address)
    network.close()


@pytest.mark.parametrize(
    "address",
    [
        "", "nonsense", "tcp/", "tcp/127.0.0.1", "tcp/:7447", "foo/127.0.0.1:1",
        "tcp/127.0.0.1:99999", "tcp/a b:1", "tcp/learner:", "127.0.0.1:7447", "unixsock-stream/",
        "udp/127.0.0.1:7447", "tls/learner:7447", "quic/learner:7447", "ws/learner:7447",
    ],
)  # fmt: skip
def test_a_malformed_address_is_refused_at_both_ends(address):
    listening = partial(listening_address, insecure=True)
    for flag, opening in (("--listen", listening), ("--connect", open_connecting)):
        sentence = f"{flag} is {address!r}, expected an address such as tcp/learner:7447"
        with pytest.raises(UsageError, match=re.escape(sentence)):
            opening(address)


def test_an_address_of_another_host_cannot_be_listened_on():
    with pytest.raises(
        UsageError, match=r"cannot listen on tcp/192\.0\.2\.1:7447: .*of this host"
    ):
        open_listening("tcp/192.0.2.1:7447")


def test_nobody_at_an_address_is_none():
    assert open_connecting(free_address()) is None
