"""Whoever else is on the learner's port: noise, bombs, echoes of what was said, and a liar.

A stranger here knows the keys and the form of messages. It costs time, never bits.
"""

import random
import signal
from contextlib import contextmanager
from itertools import islice

import msgpack
import pytest
import zenoh

from dppo.wire import codec
from dppo.wire.codec import Frame, decode, encode, sealed
from dppo.wire.links import WorkerLost
from dppo.wire.messages import VERSION, Alive, Collected, Gradient, Hello, Measured, Stop
from dppo.wire.zenoh_links import BASE, ZenohLearnerLink, open_connecting
from learner.local import free_address
from tests.support import SMALL, iterations, result, wait_until

pytestmark = pytest.mark.slow
RUN = (
    "--env", "Hopper-v5", *SMALL, "--total-timesteps", str(150 * 8 * 64), "--verbose",
    "--hidden-sizes", "16", "16",
)  # fmt: skip


class Stranger:
    """A session on the learner's port that belongs to no worker."""

    def __init__(self, session):
        self.session, self.heard = session, []

    def listen(self):
        """Keep a copy of every message of every worker, and of the name it came under."""
        self._ear = self.session.declare_subscriber(f"{BASE}/g/*", self._keep)

    def _keep(self, sample):
        attachment = sample.attachment
        if attachment is not None:
            self.heard.append((str(sample.key_expr), attachment, sample.payload))

    def put(self, key, header, body=b""):
        """Bytes with the checksum that belongs to them."""
        frame = Frame(header, body)
        self.session.put(f"{BASE}/{key}", body, attachment=sealed(frame))

    def say(self, key, message):
        frame = encode(message)
        self.put(key, frame.header, frame.body)


class Case:
    """A run of two external workers, one of them named, and a stranger that has come to it."""

    def __init__(self, harness, stranger_at=3):
        self.echoed, self.run_dir, self.address = 0, harness.folder / "run", free_address()
        self.workers = [harness.worker(self.address) for _ in range(2)]
        self.learner = harness.learner(
            *RUN, "--local-workers", "0", "--listen", self.address, run_dir=self.run_dir
        )
        wait_until(lambda: iterations(self.run_dir) >= stranger_at, "the first iterations")
        words = [line.split() for line in self.learner.text.splitlines() if " joined, " in line]
        self.names = [each[each.index("worker") + 1] for each in words]

    @contextmanager
    def stranger(self):
        session = open_connecting(self.address)
        assert session is not None
        with session:
            yield Stranger(session)

    def costs_no_bits(self, undisturbed):
        assert self.learner.wait() == 0, self.learner.text
        assert [worker.wait() for worker in self.workers] == [0, 0]
        assert "Traceback" not in self.learner.text
        for worker in self.workers:
            assert "Traceback" not in worker.text
        assert result(self.run_dir)["parameters_sha256"] == undisturbed


def test_random_bytes_on_every_key_cost_no_bits(harness, undisturbed):
    case, dice = Case(harness), random.Random(0)
    keys = [f"{way}/{name}" for way in "gp" for name in (*case.names, "x", "a-b")]
    keys += ["live/learner", "live/w/x", f"live/w/{case.names[0]}", "g", "anything/else"]
    with case.stranger() as stranger:
        for key in keys:
            for size in (0, 1, 40, 5000):
                stranger.session.put(f"{BASE}/{key}", dice.randbytes(size))
                stranger.session.put(
                    f"{BASE}/{key}", dice.randbytes(size), attachment=dice.randbytes(size)
                )
                stranger.put(key, dice.randbytes(size), dice.randbytes(size))
    case.costs_no_bits(undisturbed)
    assert "ignored a message: " in case.learner.text
    assert "is not msgpack" in case.learner.text


BOMBS = {
    "an array of 4 billion": b"\xdd\xff\xff\xff\xff",
    "depth": b"\x91" * 100_000,
    "a map of 4 billion": b"\xdf\xff\xff\xff\xff",
    "a text of 4 GB": b"\xdb\xff\xff\xff\xff",
    "an extension": msgpack.packb(msgpack.ExtType(5, b"x" * 1000)),
    "a vector of 2^60": msgpack.packb([VERSION, "Gradient", ["x", 1, 0, 1, 0, 1, [], 1 << 60, 7]]),
    "a header beyond the limit": b"\x00" * ((1 << 20) + 1),
}


def test_bombs_for_the_decoder_cost_no_bits(harness, undisturbed):
    case = Case(harness)
    with case.stranger() as stranger:
        for bomb in BOMBS.values():
            for key in ("g/x", f"g/{case.names[0]}", *(f"p/{name}" for name in case.names)):
                stranger.put(key, bomb)
    case.costs_no_bits(undisturbed)
    for refusal in ("is not msgpack", "ends at byte", "bytes, at most"):
        assert refusal in case.learner.text


def test_messages_said_again_later_or_twice_cost_no_bits(harness, undisturbed):
    """Every answer of some iterations, at once, and all of them again much later."""
    case = Case(harness)
    answers = (Gradient, Collected, Measured)
    with case.stranger() as stranger:
        stranger.listen()

        def said_again():
            """Some more of the answers so far, from the first one on; is the run far enough?"""
            for key, header, body in islice(stranger.heard, case.echoed, case.echoed + 200):
                case.echoed += 1
                if isinstance(decode(Frame(header.to_bytes()[:-4], body.to_bytes())), answers):
                    stranger.session.put(key, body, attachment=header)
            assert case.learner.popen.poll() is None, case.learner.text
            return iterations(case.run_dir) >= 60

        wait_until(said_again, "sixty iterations")
        assert case.echoed > 200
    case.costs_no_bits(undisturbed)
    assert " left: " not in case.learner.text


NAMES = ["../../etc/passwd", "a/b", "a//b", "a?b", "..", "", "x" * 65, "w1\n", "*", "**", "ä"]


def test_workers_with_names_that_could_be_paths_are_not_welcomed(harness, undisturbed):
    case = Case(harness)
    with case.stranger() as stranger:
        for name in NAMES:
            stranger.say("g/x", Hello(worker=name, host="", pid=7, numerics="", versions=""))
            stranger.say("g/x", Alive(worker=name, generation=1, done=1))
    case.costs_no_bits(undisturbed)
    for name in NAMES:
        for kind in ("Hello", "Alive"):
            sentence = f"a {kind} of a worker called {name!r}: letters, digits and '-' only"
            assert sentence in case.learner.text
    assert case.learner.text.count(" joined, ") == 2


def test_a_worker_that_lies_is_benched_and_its_lies_reach_no_parameter(harness, undisturbed):
    """Gradients of 1e30, one in ten: each is refused and computed elsewhere."""
    run_dir, address = harness.folder / "run", free_address()
    liar = harness.start("tests.lying_worker", address)
    honest = harness.worker(address)
    learner = harness.learner(*RUN, "--local-workers", "0", "--listen", address, run_dir=run_dir)
    assert learner.wait() == 0, learner.text
    assert honest.wait() == 0, honest.text
    assert liar.wait() == 0, liar.text
    assert "with gradient per sample" in learner.text
    assert ") was refused again and again; it is sent away" in learner.text
    assert "was refused again and again" in liar.text.splitlines()[-1]
    assert result(run_dir)["parameters_sha256"] == undisturbed


def test_a_worker_is_told_by_a_learner_of_another_version_and_ends_with_exit_code_1(
    harness, monkeypatch
):
    address = free_address()
    worker, link = harness.worker(address), ZenohLearnerLink(address)
    monkeypatch.setattr(codec, "VERSION", VERSION + 1)  # of what this learner says
    while not isinstance(hello := link.receive(60.0), Hello):
        assert hello is None or isinstance(hello, WorkerLost), hello
    link.send(hello.worker, Stop(reason="install the same dppo", final=True, sent_away=True))
    assert worker.wait() == 1, worker.text
    assert worker.text.splitlines()[-1].endswith("install the same dppo")
    link.close()


def test_a_learner_tells_a_worker_of_another_version_and_goes_on(harness, undisturbed):
    case, said = Case(harness), list[zenoh.Sample]()
    values = ["old-1", "lab1", 7, "9c1e", "", "", 0, VERSION - 1]
    with case.stranger() as stranger:
        ear = stranger.session.declare_subscriber(f"{BASE}/p/old-1", said.append)

        def answered():
            stranger.put("g/old-1", msgpack.packb([VERSION - 1, "Hello", values]))
            return bool(said)

        wait_until(answered, "a Stop")
        ear.undeclare()
    case.costs_no_bits(undisturbed)
    assert said[0].attachment is not None
    assert b"Stop" in said[0].attachment.to_bytes()
    sentence = f"worker old-1 (lab1, pid 7) speaks protocol version {VERSION - 1}, the learner"
    assert sentence in case.learner.text


def test_the_stranger_of_these_tests_can_be_heard(harness):
    """Else they would show nothing: what it says as a proper worker is answered."""
    case = Case(harness)
    said: list[zenoh.Sample] = []
    with case.stranger() as stranger:
        ear = stranger.session.declare_subscriber(f"{BASE}/p/guest-1", said.append)
        hello = Hello(worker="guest-1", host="lab1", pid=7, numerics="", versions="")

        def answered():
            stranger.say("g/guest-1", hello)
            return bool(said)

        wait_until(answered, "a Welcome")
        ear.undeclare()
    assert said[0].attachment is not None
    case.learner.send(signal.SIGTERM)
    assert case.learner.wait() == 0, case.learner.text
