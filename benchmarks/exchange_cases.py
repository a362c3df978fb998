"""The cases of `exchange.py`, each in a process of its own; not to be started by hand.

    python -m benchmarks.exchange_cases CASE WORKERS ROUNDS

A round: the parameters of Ant-v4's networks go to every worker, a vector of the same length comes
back from each, the sum is there. The workers are processes that compute nothing.
"""

import multiprocessing
import os
import socket
import sys
import time
from collections.abc import Callable
from multiprocessing import shared_memory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.measuring import Result, serve
from benchmarks.puppets import Puppet, config_of, networks_of

Float32 = NDArray[np.float32]
Round = Callable[[], Float32]
SPAWN = multiprocessing.get_context("spawn")
_SIZE = networks_of(config_of(1)).size
_KEPT: list[object] = []
"""Shared memory is unmapped when nobody refers to it."""


def _start(target: Callable[..., None], *rows: tuple[Any, ...]) -> None:
    """One worker process per row of arguments; they end with this one."""
    for row in rows:
        SPAWN.Process(target=target, args=row, daemon=True).start()


def _port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def zmq(workers: int) -> Round:
    """ZeroMQ ROUTER and DEALER over TCP: a header and the bytes, nothing is checked."""
    import zmq as library

    router = library.Context.instance().socket(library.ROUTER)
    port = router.bind_to_random_port("tcp://127.0.0.1")
    _start(_zmq_worker, *((port, number) for number in range(workers)))
    names = [router.recv_multipart()[0] for _ in range(workers)]
    parameters = np.zeros(_SIZE, np.float32)

    def play() -> Float32:
        body = parameters.tobytes()
        for name in names:
            router.send_multipart([name, b"update", body])
        return sum_of(np.frombuffer(router.recv_multipart()[2], np.float32) for _ in names)

    return play


def _zmq_worker(port: int, number: int) -> None:
    import zmq as library

    dealer = library.Context.instance().socket(library.DEALER)
    dealer.setsockopt(library.IDENTITY, f"worker-{number}".encode())
    dealer.connect(f"tcp://127.0.0.1:{port}")
    dealer.send_multipart([b"hello", b""])
    vector = Puppet("", _SIZE).vector
    while True:
        np.frombuffer(dealer.recv_multipart()[1], np.float32).copy()
        dealer.send_multipart([b"gradient", vector.tobytes()])


def sum_of(vectors: Any) -> Float32:  # noqa: ANN401  any iterable of vectors
    """Added one after the other."""
    total = np.zeros(_SIZE, np.float32)
    for vector in vectors:
        total += vector
    return total


def shared(workers: int) -> Round:
    """Shared memory and two semaphores per worker: about the least that two processes need."""
    memory = shared_memory.SharedMemory(create=True, size=4 * _SIZE * (1 + workers))
    rows = _rows(memory, 1 + workers)
    asked = [SPAWN.Semaphore(0) for _ in range(workers)]
    done = SPAWN.Semaphore(0)
    _start(
        _shared_worker,
        *((memory.name, 1 + workers, n + 1, asked[n], done) for n in range(workers)),
    )
    parameters = np.zeros(_SIZE, np.float32)

    def play() -> Float32:
        rows[0] = parameters
        for semaphore in asked:
            semaphore.release()
        for _ in asked:
            done.acquire()
        return sum_of(rows[1:])

    play()
    memory.unlink()  # all have it open now; nothing is left behind
    _KEPT.append(memory)
    return play


def _rows(memory: shared_memory.SharedMemory, count: int) -> Float32:
    """[count, P] parameters, then one vector per worker."""
    return np.ndarray((count, _SIZE), np.float32, memory.buf)


def _shared_worker(name: str, rows_in_all: int, row: int, asked: Any, done: Any) -> None:  # noqa: ANN401
    memory = shared_memory.SharedMemory(name)
    rows = _rows(memory, rows_in_all)
    vector = Puppet("", _SIZE).vector
    while True:
        asked.acquire()
        rows[0].copy()
        rows[row] = vector
        done.release()


def gloo(workers: int) -> Round:
    """torch.distributed with gloo: a broadcast and an all-reduce."""
    import torch

    torch.set_num_threads(1)
    port = _port()
    _start(_gloo_worker, *((port, number + 1, workers + 1) for number in range(workers)))
    distributed = _joined(port, 0, workers + 1)
    parameters, total = torch.zeros(_SIZE), torch.zeros(_SIZE)

    def play() -> Float32:
        distributed.broadcast(parameters, 0)
        total.zero_()
        distributed.all_reduce(total)
        return np.asarray(total.numpy())

    return play


def _joined(port: int, rank: int, size: int) -> Any:  # noqa: ANN401  a module
    from torch import distributed

    address = f"tcp://127.0.0.1:{port}"
    distributed.init_process_group("gloo", init_method=address, rank=rank, world_size=size)
    return distributed


def _gloo_worker(port: int, rank: int, size: int) -> None:
    import torch

    torch.set_num_threads(1)
    distributed = _joined(port, rank, size)
    parameters, vector = torch.zeros(_SIZE), torch.from_numpy(Puppet("", _SIZE).vector)
    while True:
        distributed.broadcast(parameters, 0)
        distributed.all_reduce(vector.clone())


def _ours(name: str) -> Callable[[int], Round]:
    """A case of `exchange_ours`, imported late: a peer's interpreter need not have Zenoh."""

    def case(workers: int) -> Round:
        from benchmarks import exchange_ours

        round_: Round = getattr(exchange_ours, name)(workers)
        return round_

    return case


CASES: dict[str, Callable[[int], Round]] = {
    "pairs": _ours("pairs"),
    "zenoh": _ours("zenoh"),
    "zmq": zmq,
    "shared": shared,
    "gloo": gloo,
}


def _prepared(case: str, workers: int, rounds: int) -> Callable[[], Result]:
    play = CASES[case](workers)
    expected = workers * Puppet("", _SIZE).vector
    np.testing.assert_allclose(play(), expected, rtol=1e-5)

    def measure() -> Result:
        times = []
        for _ in range(rounds):
            begun = time.perf_counter()
            play()
            times.append(1000 * (time.perf_counter() - begun))
        low, high = np.percentile(times, [50, 90])
        return {"ms": float(low), "p90_ms": float(high)}

    return measure


if __name__ == "__main__":
    name, count, repeats = sys.argv[1:]
    serve(lambda: _prepared(name, int(count), int(repeats)))
    for child in multiprocessing.active_children():
        child.kill()
    os._exit(0)  # Zenoh's threads do not wait for anybody
