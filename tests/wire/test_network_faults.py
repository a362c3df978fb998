"""Zenoh's links when one end does not read, or the way breaks in the middle of a message."""

import os
import signal
import subprocess
import sys
import time
from functools import partial

import numpy as np
import pytest

from dppo.chaos.proxy import Proxy
from dppo.wire.links import LearnerLost, Refused, WorkerLost
from dppo.wire.messages import Hello, Measure, Stop
from dppo.wire.zenoh_links import ZenohLearnerLink, ZenohWorkerLink, open_connecting
from learner.local import free_address
from tests.support import ROOT, state_of, wait_until

pytestmark = pytest.mark.slow
PATIENCE = 20.0
BLOCKED_SECONDS = 0.5
"""`wait_before_close` in docs/protocol.md: how long a full queue holds up the learner."""
SLEEPER = """
import sys
from functools import partial
from dppo.wire.messages import Hello
from dppo.wire.zenoh_links import ZenohWorkerLink, open_connecting
link = ZenohWorkerLink(open_connecting(sys.argv[1]), "sleeper")
while link.receive(0.1) is None:
    link.send(Hello(worker="sleeper", host="", pid=1, numerics="", versions=""))
print("heard", flush=True)
while True:
    link.receive(60.0)
"""


def hello(name):
    return Hello(worker=name, host="", pid=1, numerics="", versions="")


def measure(size, number):
    vector = np.full(size, number, np.float32)
    return Measure(generation=1, iteration=0, round=number, slots=(0,), parameters=vector)


def until(link, wanted, meanwhile=lambda: None):
    """What has come up to the first event that is `wanted`."""
    events, deadline = [], time.monotonic() + PATIENCE
    while time.monotonic() < deadline:
        meanwhile()
        event = link.receive(0.05)
        if event is not None:
            events.append(event)
            if wanted(event):
                return events
    pytest.fail(f"no such event within {PATIENCE} s, but {events}")


@pytest.fixture
def address():
    return free_address()


@pytest.fixture
def learner(address):
    link = ZenohLearnerLink(address)
    yield link
    link.close()


def worker_at(address, name):
    session = open_connecting(address)
    assert session is not None
    return ZenohWorkerLink(session, name, partial(open_connecting, address))  # as the program


@pytest.fixture
def sleeper(learner, address):
    """A worker in a process of its own, which has heard something."""
    process = subprocess.Popen(
        [sys.executable, "-c", SLEEPER, address],
        cwd=ROOT,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
    )
    until(learner, lambda event: event == hello("sleeper"))
    learner.send("sleeper", Stop(reason="hear", final=False))
    assert process.stdout is not None
    with process.stdout as said:
        assert said.readline() == b"heard\n"
        yield process
    process.kill()
    process.wait()


def test_a_worker_that_never_reads_holds_up_nobody_for_long(learner, sleeper, address):
    other = worker_at(address, "other")
    until(learner, lambda event: event == hello("other"), lambda: other.send(hello("other")))
    sleeper.send_signal(signal.SIGSTOP)
    wait_until(lambda: state_of(sleeper.pid) == "T", "the worker to stop")
    waited, begun = 64 * BLOCKED_SECONDS, time.monotonic()  # if each message were waited for
    for number in range(64):  # 64 MB: more than queue and sockets take
        learner.send("sleeper", measure(1 << 18, number))
    learner.send("other", measure(1 << 18, 7))
    assert time.monotonic() - begun < waited / 4
    (found,) = until(other, lambda event: isinstance(event, Measure))
    assert found.parameters.tobytes() == measure(1 << 18, 7).parameters.tobytes()
    other.close()


def test_a_connection_cut_in_the_middle_of_a_message_gives_no_part_of_it(learner, address):
    """Four megabytes are 64 fragments; at 1 Mbit/s the first of them are under way for long."""
    proxy = Proxy(int(address.rpartition(":")[2]))
    worker = worker_at(proxy.address, "w1")
    until(learner, lambda event: event == hello("w1"), lambda: worker.send(hello("w1")))
    proxy.set(["slow"])
    learner.send("w1", measure(1 << 20, 1))
    wait_until(lambda: _under_way(proxy) > 0, "bytes on the way")
    proxy.cut()
    proxy.set([])
    events = until(worker, lambda event: event == LearnerLost())
    lost = until(learner, lambda event: event == WorkerLost("w1"))
    assert not any(isinstance(event, Measure | Refused) for event in (*events, *lost))
    until(learner, lambda event: event == hello("w1"), lambda: worker.send(hello("w1")))
    learner.send("w1", measure(1 << 20, 2))
    (*_, found) = until(worker, lambda event: isinstance(event, Measure))
    assert found.parameters.tobytes() == measure(1 << 20, 2).parameters.tobytes()
    worker.close()
    proxy.close()


def _under_way(proxy):
    return sum(lane.held for each in proxy._connections for lane in each.lanes.values())
