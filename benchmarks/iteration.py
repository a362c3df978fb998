"""One training iteration, split: physics, observations, inference, gradients, exchange, idle.

    python -m benchmarks.iteration --env Ant-v4

A real learner and real workers over Zenoh, with timers around their functions (`stopwatch.py`).
The timers cost about a microsecond a call, which shows in the cheapest physics only.
"""

import argparse
import json
import os
import subprocess
import sys
from dataclasses import replace
from typing import Any

from benchmarks.measuring import ONE_THREAD, Result, say, started, table, usable_cores
from benchmarks.puppets import config_of
from benchmarks.stopwatch import REST, Place, Stopwatch

WORKER: tuple[Place, ...] = (
    ("mujoco:mj_step", "physics"),
    ("mujoco:mj_rnePostConstraint", "physics"),
    ("workers.mujoco_vec:MujocoVec.step", "observations"),
    ("workers.generic_vec:GenericVec.step", "observations"),
    ("workers.episodes:Episodes.step", "observations"),
    ("workers.episodes:Episodes.begin", "resets"),
    ("dppo.networks:Mlp.forward", "recording>inference"),
    ("workers.slots:Slots.collect", "recording"),
    ("workers.slots:Slots.snapshot", "snapshots"),
    ("workers.worker:prepare", "advantages"),
    ("workers.worker:combine", "advantages"),
    ("workers.worker:block_gradient", "gradients"),
    ("workers.worker:block_sum", "gradients"),
    ("workers.worker:slot_kl", "final KL"),
    ("dppo.wire.zenoh_links:ZenohWorkerLink.send", "exchange"),
    ("dppo.wire.inbox:decode", "exchange"),
    ("dppo.wire.zenoh_links:ZenohWorkerLink.receive", "idle"),
)
LEARNER: tuple[Place, ...] = (
    ("dppo.wire.zenoh_links:ZenohLearnerLink.send", "exchange"),
    ("dppo.wire.inbox:decode", "exchange"),
    ("dppo.wire.zenoh_links:ZenohLearnerLink.receive", "idle"),
    ("learner.exchange:Exchange.gather", "rounds"),
    ("learner.chief:block_sum", "sums"),
    ("learner.chief:Chief._change", "Adam"),
)
_WARM = 2
"""Iterations before timing begins: the first one does not learn."""


def main() -> None:
    """Train a few iterations under timers."""
    args = _arguments()
    if args.connect:
        _work(args.connect, args.name)
    found = _measured(args)
    labels = [label.rpartition(">")[2] for _, label in (*WORKER, *LEARNER)]
    rows: list[Result] = [{"ms per iteration": label} for label in dict.fromkeys([*labels, REST])]
    for name, times in found.items():
        total = sum(times.values())
        for row in rows:
            spent = times.get(row["ms per iteration"], 0.0)
            row |= {name: spent, f"{name} %": 100 * spent / total}
    table(rows)


def _measured(args: argparse.Namespace) -> dict[str, dict[str, float]]:
    """Milliseconds per iteration by label, of the learner and of every worker."""
    from learner.local import free_address

    address = free_address()
    workers = {f"worker-{number}": _started(address, number) for number in range(args.workers)}
    try:
        found = {"learner": _lead(address, args)}
        for name, worker in workers.items():
            found[name] = json.loads(worker.communicate(timeout=60)[0].splitlines()[-1])
    finally:
        for worker in workers.values():
            worker.kill()
    times = {}
    for name, (seconds, absent) in found.items():
        times[name] = {label: 1000 * s / args.iterations for label, s in seconds.items()}
        say(
            {
                "benchmark": "iteration", "env": args.env, "workers": args.workers,
                "process": name, "ms": times[name], "absent": absent,
            }
        )  # fmt: skip
    return times


def _started(address: str, number: int) -> subprocess.Popen[str]:
    words = [sys.executable, "-m", "benchmarks.iteration", "--connect", address]
    words += ["--name", f"worker-{number}"]
    return started(words, ONE_THREAD, stdout=subprocess.PIPE)


def _lead(address: str, args: argparse.Namespace) -> tuple[dict[str, float], list[str]]:
    """The learner: seconds by label over the timed iterations, places that are not there."""
    from dppo.leases import Leases
    from dppo.networks import Networks
    from dppo.wire.messages import Welcome
    from dppo.wire.zenoh_links import ZenohLearnerLink
    from learner.chief import Chief
    from learner.exchange import Exchange
    from learner.state import State

    watch = Stopwatch()
    absent = watch.put_on(LEARNER)
    config = config_of(args.slots)
    steps = config.rollout.samples * (_WARM + args.iterations) * 10
    config = replace(config, run=replace(config.run, env=args.env, total_timesteps=steps))
    link = ZenohLearnerLink(address)
    welcome = Welcome(run="iteration", generation=1, config=json.dumps(config.to_dict()))
    exchange = Exchange(link, welcome, Leases(args.slots), lambda: None, lambda: networks.size)
    spaces = exchange.wait_for_environment()
    networks = Networks.build(spaces, config)
    state = State.initial(networks, spaces.obs_size, config)
    chief = Chief(state, networks, config, 1, exchange, print)
    for _ in range(_WARM):
        chief.iterate()
    watch.reset()
    for _ in range(args.iterations):
        chief.iterate()
    seconds = watch.read()
    exchange.stop("the benchmark is over", final=True)
    return seconds, absent


def _work(address: str, name: str) -> None:
    """One worker; prints its seconds by label at the end."""
    from dppo.wire.zenoh_links import ZenohWorkerLink, open_connecting
    from workers.envs import quiet
    from workers.membership import Member, wait_for
    from workers.worker import Worker

    quiet()
    watch = Stopwatch()
    absent = watch.put_on(WORKER)
    perform = Worker.perform

    def begin_at_warm(worker: Worker, task: Any) -> None:  # noqa: ANN401  any task
        if task.iteration == _WARM and type(task).__name__ == "Collect":
            watch.reset()
        perform(worker, task)

    Worker.perform = begin_at_warm  # type: ignore[method-assign, assignment]

    def connect() -> ZenohWorkerLink | None:
        session = open_connecting(address)
        return None if session is None else ZenohWorkerLink(session, name)

    Member(name, wait_for(connect, address, 60.0), 60.0).live()
    print(json.dumps([watch.read(), absent]), flush=True)
    os._exit(0)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--env", default="Ant-v4")
    parser.add_argument("--workers", type=int, default=len(usable_cores()))
    parser.add_argument("--slots", type=int, default=8)
    parser.add_argument("--iterations", type=int, default=10)
    parser.add_argument("--connect", default="", help=argparse.SUPPRESS)
    parser.add_argument("--name", default="", help=argparse.SUPPRESS)
    return parser.parse_args()


if __name__ == "__main__":
    main()
