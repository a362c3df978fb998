"""Our cases of `exchange.py`, and their workers on socket pairs; not to be started by hand.

What training does: `Exchange.gather` with everything it checks, children looked after, the sum.
"""

import argparse
import json
import multiprocessing
import os
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.pairs import Pairs, learner_link, serve_puppet
from benchmarks.puppets import config_of, networks_of
from dppo.leases import Leases
from dppo.sums import block_sum, whole
from dppo.wire.messages import Collect, Gradient, Update, Welcome
from dppo.wire.socket_links import SocketLearnerLink, SocketWorkerLink
from dppo.wire.zenoh_links import ZenohWorkerLink, open_connecting
from learner.exchange import Exchange
from learner.local import free_address
from learner.soundness import Expected

Float32 = NDArray[np.float32]
SPAWN = multiprocessing.get_context("spawn")
SIZE = networks_of(config_of(1)).size


def pairs(workers: int) -> Callable[[], Float32]:
    """Workers that the learner has started: socket pairs and shared memory."""
    link = learner_link(free_address())
    children = Pairs(link, workers, verbose=False, module="benchmarks.exchange_ours")
    children.start()
    return _round(workers, link, children.look_after)


def zenoh(workers: int) -> Callable[[], Float32]:
    """Workers that connect to the learner."""
    address = free_address()
    for number in range(workers):
        SPAWN.Process(target=_connect, args=(address, f"puppet-{number}"), daemon=True).start()
    return _round(workers, learner_link(address), lambda: None)


def _round(
    workers: int, link: SocketLearnerLink, look_after: Callable[[], None]
) -> Callable[[], Float32]:
    """One update's round, when all have joined."""
    config = config_of(workers)
    welcome = Welcome(run="exchange", generation=1, config=json.dumps(config.to_dict()))
    exchange = Exchange(link, welcome, Leases(workers), look_after)
    spaces = exchange.wait_for_environment()
    exchange.expected = Expected(spaces, SIZE, config.rollout.samples_per_slot)
    parameters, slots = np.zeros(SIZE, np.float32), tuple(range(workers))
    same: Any = {"generation": 1, "iteration": 0, "slots": slots, "parameters": parameters}
    one = np.zeros(3)
    collect = Collect(
        round=0,
        psi=0.1,
        beta=1.0,
        mean_reward=0.0,
        obs=np.zeros(55),
        returns=one,
        sigma_target=one,
        **same,
    )
    complete = False
    while not complete:  # until all have joined, and once more: slots are spread at the beginning
        complete = exchange.num_workers == workers
        exchange.begin_iteration(collect, {})
        exchange.gather(collect, quorum=workers)
    number = 0

    def play() -> Float32:
        nonlocal number
        number += 1
        update = Update(round=number, stopped=(), advantages=np.zeros(7), **same)
        answers = exchange.gather(update, quorum=workers).answers
        vectors = {
            b: answer.vector for b, answer in answers.items() if isinstance(answer, Gradient)
        }
        return block_sum(vectors, whole(workers))

    return play


def _connect(address: str, name: str) -> None:
    """A worker over Zenoh."""
    while (session := open_connecting(address)) is None:
        time.sleep(0.05)
    serve_puppet(name, ZenohWorkerLink(session, name), SIZE)
    os._exit(0)


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--name")
    parser.add_argument("--socket", nargs="+", type=int)
    own = parser.parse_args()
    serve_puppet(own.name, SocketWorkerLink(own.socket, lambda: os._exit(0)), SIZE)
    os._exit(0)
