"""What only a pair of sockets can do wrong, and what it does about it."""

import errno
import gc
import os
import socket
import struct
import time
from pathlib import Path

import numpy as np
import pytest

from dppo.wire.channel import Channel
from dppo.wire.links import LearnerLost, Refused, WorkerLost
from dppo.wire.memory_links import MemoryHub
from dppo.wire.messages import Hello, Measure, Stop
from dppo.wire.shared_bodies import CELL_BYTES, SharedBodies, new_memory
from dppo.wire.socket_links import Alarm, SocketLearnerLink, SocketWorkerLink

PATIENCE = 10.0
HELLO = Hello(worker="w1", host="here", pid=1, numerics="9c1e", versions="")


@pytest.fixture
def learner():
    link = SocketLearnerLink(MemoryHub().learner(), Alarm())
    yield link
    link.close()


@pytest.fixture
def worker(learner):
    inherited = learner.adopt("w1")
    link = SocketWorkerLink([os.dup(d) for d in inherited.descriptors], lambda: None)
    inherited.close()
    yield link
    link.close()


def measure(size, seed=0):
    vector = np.random.default_rng(seed).standard_normal(size).astype(np.float32)
    return Measure(generation=1, iteration=0, round=seed, slots=(0,), parameters=vector)


def next_message(link, pump=lambda: None):
    """The next message; `pump` lets the other end write on."""
    deadline = time.monotonic() + PATIENCE
    while time.monotonic() < deadline:
        pump()
        if (event := link.receive(0.01)) is not None:
            return event
    pytest.fail(f"nothing came within {PATIENCE} s")


@pytest.mark.parametrize("size", [0, 1, CELL_BYTES // 4, CELL_BYTES // 4 + 1, 5 * CELL_BYTES // 4])
def test_a_body_arrives_through_memory_or_through_the_socket(learner, worker, size):
    sent = measure(size)
    learner.send("w1", sent)
    found = next_message(worker, lambda: learner.receive(0.0))
    assert found.parameters.tobytes() == sent.parameters.tobytes()


def test_a_worker_that_does_not_read_never_holds_up_the_learner(learner, worker):
    for number in range(40):  # 40 MB: more than memory and socket take
        learner.send("w1", measure(CELL_BYTES // 4, number))
    for number in range(40):
        found = next_message(worker, lambda: learner.receive(0.0))
        assert found.round == number
        assert found.parameters.tobytes() == measure(CELL_BYTES // 4, number).parameters.tobytes()


def test_messages_of_the_other_link_wake_the_learner():
    hub, alarm = MemoryHub(), Alarm()
    link = SocketLearnerLink(hub.learner(), alarm)
    hub.worker("far").send(HELLO)
    alarm.ring()
    assert link.receive(PATIENCE) == HELLO
    assert link.receive(0.0) is None
    link.close()


def test_a_length_beyond_the_limits_ends_the_connection(learner):
    inherited = learner.adopt("w1")
    inherited.end.sendall(struct.pack("<IIi", 1 << 30, 0, -1))
    refused = next_message(learner)
    assert isinstance(refused, Refused)
    assert "bytes was announced, at most" in refused.reason
    assert next_message(learner) == WorkerLost("w1")
    inherited.close()


@pytest.mark.parametrize("kept", [1, 11, 12, 40, -1])
def test_half_a_message_is_no_message_and_its_end_is_told(learner, kept):
    """What a worker leaves that is killed while it sends."""
    ours, theirs = socket.socketpair()
    message = b"".join(Channel(ours, None).pieces(measure(1000)))
    assert len(message) > 4000
    inherited = learner.adopt("w1")
    inherited.end.sendall(b"".join(Channel(ours, None).pieces(HELLO)) + message[:kept])
    inherited.close()
    assert next_message(learner) == HELLO
    assert next_message(learner) == WorkerLost("w1")
    ours.close()
    theirs.close()


@pytest.mark.parametrize(("cell", "length"), [(7, 8), (0, 2 * CELL_BYTES), (-2, 8)])
def test_a_cell_that_does_not_exist_ends_the_connection(learner, cell, length):
    inherited = learner.adopt("w1")
    inherited.end.sendall(struct.pack("<IIi", 1, length, cell) + b"x")
    refused = next_message(learner)
    assert isinstance(refused, Refused)
    assert "a body was said to be in shared memory" in refused.reason
    assert next_message(learner) == WorkerLost("w1")
    inherited.close()


def test_a_worker_whose_learner_is_gone_is_told_and_may_end_itself():
    learner, orphaned = SocketLearnerLink(MemoryHub().learner(), Alarm()), []
    inherited = learner.adopt("w1")
    link = SocketWorkerLink(
        [os.dup(d) for d in inherited.descriptors], lambda: orphaned.append(True)
    )
    inherited.close()
    learner.close()
    assert link.receive(PATIENCE) == LearnerLost()
    deadline = time.monotonic() + PATIENCE
    while not orphaned and time.monotonic() < deadline:
        link.receive(0.05)
    assert orphaned == [True]
    link.close()


def test_what_a_worker_said_before_it_died_is_heard_even_if_the_learner_speaks_first(learner):
    inherited = learner.adopt("w1")
    link = SocketWorkerLink([os.dup(d) for d in inherited.descriptors], lambda: None)
    inherited.close()
    link.send(HELLO)
    link.close()
    learner.send("w1", measure(1))
    assert next_message(learner) == HELLO
    assert next_message(learner) == WorkerLost("w1")


def test_processes_that_a_worker_starts_inherit_nothing_of_the_pair(learner):
    inherited = learner.adopt("w1")
    copies = [os.dup(d) for d in inherited.descriptors]
    for descriptor in copies:
        os.set_inheritable(descriptor, True)
    link = SocketWorkerLink(copies, lambda: None)
    assert not os.get_inheritable(copies[0])
    with pytest.raises(OSError, match="Bad file descriptor"):
        os.fstat(copies[1])  # the memory is mapped: its descriptor is not kept
    link.close()
    inherited.close()


@pytest.mark.parametrize("call", ["memfd_create", "ftruncate"])
def test_where_memory_cannot_be_shared_bodies_take_the_socket(monkeypatch, call):
    def refuse(*_arguments):
        raise OSError(errno.ENOSYS, "Function not implemented")

    gc.collect()  # what earlier tests left open is closed now, not in between
    before = sorted(Path("/proc/self/fd").iterdir())
    monkeypatch.setattr(os, call, refuse)
    assert new_memory() is None
    assert sorted(Path("/proc/self/fd").iterdir()) == before


def test_a_cell_is_free_again_once_its_body_was_taken():
    memory = new_memory()
    assert memory is not None
    sender, receiver = SharedBodies(memory, True), SharedBodies(memory, False)
    assert [sender.put(b"one"), sender.put(b"two"), sender.put(b"three")] == [0, 1, None]
    assert bytes(receiver.take(1, 3)) == b"two"
    assert sender.put(b"four") == 1
    assert bytes(receiver.take(0, 3)) == b"one"
    assert receiver.put(b"back") == 0  # the other direction has slots of its own
    assert bytes(sender.take(0, 4)) == b"back"
    os.close(memory)


def test_stop_reaches_a_worker_before_the_pair_is_closed(learner, worker):
    learner.send("w1", Stop(reason="the run is finished", final=True))
    learner.let_go()
    assert next_message(worker) == Stop(reason="the run is finished", final=True)
    assert worker.receive(PATIENCE) == LearnerLost()
