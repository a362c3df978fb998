"""The proxy between plain sockets: clear it is a wire, and each kind of weather can be seen."""

import random
import socket
import time
from contextlib import closing, suppress

import pytest

from dppo.chaos.proxy import Proxy
from tests.support import wait_until

PATIENCE = 10.0


def listening(port=0):
    server = socket.create_server(("127.0.0.1", port))
    server.settimeout(PATIENCE)
    return server


@pytest.fixture
def server():
    with listening() as server:
        yield server


@pytest.fixture
def proxy(server):
    with closing(Proxy(server.getsockname()[1])) as proxy:
        yield proxy


def connected(proxy):
    return socket.create_connection(("127.0.0.1", proxy.port), PATIENCE)


@pytest.fixture
def pair(server, proxy):
    """A worker's end and the learner's end."""
    with connected(proxy) as worker:
        learner, _ = server.accept()
        with learner:
            learner.settimeout(PATIENCE)
            yield worker, learner


def received(end, count):
    data = b""
    while len(data) < count and (more := end.recv(count - len(data))):
        data += more
    return data


def is_silent(end):
    """Nothing to read now."""
    before = end.gettimeout()
    end.settimeout(0)
    try:
        return end.recv(1, socket.MSG_PEEK) is None
    except BlockingIOError:
        return True
    finally:
        end.settimeout(before)


def let_it_go_round(proxy):
    """Until it has tried to move what there is, once more from the beginning to the end."""
    for _ in range(2):  # it may have begun before
        before = proxy._connections  # each time it makes a new list of those that stand

        def is_done(before=before):
            return proxy._connections is not before

        wait_until(is_done, "the proxy to look at its connections", PATIENCE)


def test_bytes_pass_both_ways_unaltered(pair):
    worker, learner = pair
    data = random.Random(0).randbytes(1 << 20)
    for source, sink in (pair, pair[::-1]):
        source.settimeout(0)
        sent, got = 0, b""
        while len(got) < len(data):  # one thread: as much goes in as comes out
            if sent < len(data):
                with suppress(BlockingIOError):
                    sent += source.send(data[sent : sent + 4096])
            if not is_silent(sink):
                got += sink.recv(65536)
        assert got == data
    worker.settimeout(PATIENCE)
    learner.settimeout(PATIENCE)


def test_the_end_of_one_side_reaches_the_other_after_its_last_bytes(pair):
    worker, learner = pair
    worker.sendall(b"bye")
    worker.close()
    assert received(learner, 9) == b"bye"


def test_a_delay_takes_200_ms_each_way(proxy, pair):
    worker, learner = pair
    proxy.set({"delay"})
    for source, sink in ((worker, learner), (learner, worker)):
        begun = time.monotonic()
        source.sendall(b"x")
        assert received(sink, 1) == b"x"
        assert time.monotonic() - begun >= 0.2


def test_a_slow_link_passes_a_megabit_per_second(proxy, pair):
    worker, learner = pair
    proxy.set({"slow"})
    begun = time.monotonic()
    worker.sendall(bytes(25_000))
    assert len(received(learner, 25_000)) == 25_000
    assert time.monotonic() - begun >= 0.2


@pytest.mark.parametrize(("kind", "ways"), [
    ("partition", (False, False)),
    ("partition-to-learner", (False, True)),
    ("partition-to-worker", (True, False)),
])  # fmt: skip
def test_a_partition_holds_bytes_back_and_gives_them_when_it_is_over(proxy, pair, kind, ways):
    worker, learner = pair
    proxy.set({kind})
    worker.sendall(b"up")
    learner.sendall(b"down")
    with connected(proxy) as marker:  # knocks while nobody is let in
        for sink, passes, text in ((learner, ways[0], b"up"), (worker, ways[1], b"down")):
            if passes:
                assert received(sink, len(text)) == text
        let_it_go_round(proxy)
        assert proxy.connections == 1
        for sink, passes in ((learner, ways[0]), (worker, ways[1])):
            assert passes or is_silent(sink)
        proxy.set(())
        for sink, passes, text in ((learner, ways[0], b"up"), (worker, ways[1], b"down")):
            if not passes:
                assert received(sink, len(text)) == text
        wait_until(lambda: proxy.connections == 2, "the other one to be let in", PATIENCE)
        assert marker.fileno() >= 0


def test_corruption_alters_one_direction_only(proxy, pair):
    worker, learner = pair
    proxy.set({"corrupt-to-learner"})
    data = bytes(4096)
    altered = 0
    for _ in range(64):
        worker.sendall(data)
        altered += received(learner, len(data)) != data
        learner.sendall(data)
        assert received(worker, len(data)) == data
    assert 0 < altered < 64


def test_a_cut_breaks_what_stands_and_the_next_connection_passes(server, proxy, pair):
    worker, learner = pair
    worker.sendall(b"x")
    assert received(learner, 1) == b"x"
    proxy.cut()
    assert received(worker, 1) == b""
    assert received(learner, 1) == b""
    with connected(proxy) as again:
        other, _ = server.accept()
        with other:
            again.sendall(b"again")
            assert received(other, 5) == b"again"


def test_the_proxy_outlives_the_one_behind_it():
    server = listening()
    port = server.getsockname()[1]
    with closing(Proxy(port)) as proxy:
        with connected(proxy) as worker:
            learner, _ = server.accept()
            learner.close()
            server.close()
            assert received(worker, 1) == b""
        with connected(proxy) as worker:
            assert received(worker, 1) == b""  # nobody there: closed at once
        with listening(port) as heir, connected(proxy) as worker:
            learner, _ = heir.accept()
            with learner:
                worker.sendall(b"hello")
                assert received(learner, 5) == b"hello"


def test_a_closed_proxy_leaves_no_listener_and_no_connection(server):
    proxy = Proxy(server.getsockname()[1])
    with connected(proxy) as worker:
        learner, _ = server.accept()
        with learner:
            proxy.close()
            assert received(worker, 1) == b""
    with pytest.raises(ConnectionRefusedError):
        connected(proxy)
