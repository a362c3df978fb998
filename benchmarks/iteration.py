"""One training iteration, split: physics, observations, inference, gradients, exchange, idle.

    python -m benchmarks.iteration --env Ant-v4

A real learner and real workers on socket pairs, as a local run has them, with timers around their
functions (`stopwatch.py`). The timers cost about a microsecond a call, which shows in the cheapest
physics only.
"""

import argparse
import json
import os
import subprocess
import sys
from dataclasses import replace
from typing import Any

from benchmarks.measuring import Result, command_line, say, table, usable_cores
from benchmarks.processes import ONE_THREAD, started
from benchmarks.puppets import config_of
from benchmarks.stopwatch import REST, Place, Stopwatch

WORKER: tuple[Place, ...] = (
    ("workers.simulations:Batched.step", "physics"),
    ("workers.simulations:OneByOne.step", "physics"),
    ("workers.kinds:Kind.observe", "observations"),
    ("workers.kinds:Kind.judge", "rewards"),
    ("workers.simulations:Batched.read", "observations"),
    ("workers.simulations:OneByOne.read", "observations"),
    ("workers.mujoco_vec:MujocoVec.step", "stepping"),
    ("workers.generic_vec:GenericVec.step", "stepping"),
    ("workers.episodes:Episodes.step", "stepping"),
    ("workers.episodes:Episodes.begin", "resets"),
    ("workers.slots:through", "inference"),
    ("workers.slots:Slots._noise", "noise"),
    ("workers.slots:Slots.collect", "recording"),
    ("workers.slots:Slots.snapshot", "snapshots"),
    ("workers.worker:prepare", "advantages"),
    ("workers.worker:combine", "advantages"),
    ("workers.worker:block_gradient", "gradients"),
    ("workers.worker:sum_rows", "gradients"),
    ("workers.worker:Worker._update", "gradients"),
    ("workers.worker:slot_kls", "final KL"),
    ("workers.core:Core.awake", "idle"),
)
LEARNER: tuple[Place, ...] = (
    ("learner.exchange:Exchange.gather", "rounds"),
    ("learner.local:LocalWorkers.look_after", "children"),
    ("learner.chief:block_sum", "sums"),
    ("learner.chief:Chief._change", "Adam"),
)
WIRE: tuple[Place, ...] = (
    ("dppo.wire.channel:encode", "codec"),
    ("dppo.wire.socket_links:decoded", "codec"),
    ("dppo.wire.shared_bodies:SharedBodies.put", "copies"),
    ("dppo.wire.shared_bodies:SharedBodies.take", "copies"),
    ("dppo.wire.channel:Channel._next", "exchange"),
)
"""On both sides; the ends of the pair differ, and waiting for what arrives is `idle`."""
LINKS: dict[str, tuple[Place, ...]] = {
    side: (
        (f"dppo.wire.socket_links:Socket{side}Link.send", "exchange"),
        (f"dppo.wire.socket_links:Socket{side}Link.receive", "idle"),
    )
    for side in ("Learner", "Worker")
}
_WARM = 2
"""Iterations before timing begins: the first one does not learn."""


def main() -> None:
    """Train a few iterations under timers."""
    args = _arguments()
    if args.socket:
        _work(args)
    if args.lead:
        _lead(args)
    found = _measured(args)
    places = (*WORKER, *LEARNER, *WIRE, *LINKS["Learner"])
    labels = [label for _, label in places]
    rows: list[Result] = [{"ms per iteration": label} for label in dict.fromkeys([*labels, REST])]
    for name, times in found.items():
        total = sum(times.values())
        for row in rows:
            spent = times.get(row["ms per iteration"], 0.0)
            row |= {name: spent, f"{name} %": 100 * spent / total}
    table(rows)


def _measured(args: argparse.Namespace) -> dict[str, dict[str, float]]:
    """Milliseconds per iteration by label, of the learner and of every worker."""
    words = [sys.executable, "-m", "benchmarks.iteration", "--lead", "--env", args.env]
    for name in ("workers", "slots", "iterations"):
        words += [f"--{name}", str(getattr(args, name))]
    with started(words, ONE_THREAD, stdout=subprocess.PIPE) as tree:
        lines = tree.process.communicate()[0].splitlines()
    found = dict(json.loads(line) for line in lines if line.startswith("["))
    times = {}
    for name, (seconds, absent) in sorted(found.items(), key=lambda item: item[0] != "learner"):
        times[name] = {label: 1000 * s / args.iterations for label, s in seconds.items()}
        say(
            {
                "benchmark": "iteration", "env": args.env, "workers": args.workers,
                "process": name, "ms": times[name], "absent": absent,
            }
        )  # fmt: skip
    return times


def _tell(name: str, watch: Stopwatch, absent: list[str]) -> None:
    """One process's seconds by label, and the places that are not there, to `_measured`."""
    print(json.dumps([name, [watch.read(), absent]]), flush=True)


def _lead(args: argparse.Namespace) -> None:
    """The learner, which starts the workers."""
    from benchmarks.pairs import Pairs, learner_link
    from dppo.leases import Leases
    from dppo.networks import Networks
    from dppo.wire.messages import Welcome
    from learner.chief import Chief
    from learner.exchange import Exchange
    from learner.ledger import Ledger
    from learner.local import free_address
    from learner.soundness import Expected
    from learner.state import State

    watch = Stopwatch()
    absent = watch.put_on((*LEARNER, *WIRE, *LINKS["Learner"]))
    config = config_of(args.slots)
    steps = config.rollout.samples * (_WARM + args.iterations) * 10
    config = replace(config, run=replace(config.run, env=args.env, total_timesteps=steps))
    link = learner_link(free_address())
    children = Pairs(
        link, args.workers, verbose=False, module="benchmarks.iteration", keeps_cores=True
    )
    welcome = Welcome(run="iteration", generation=1, config=json.dumps(config.to_dict()))
    exchange = Exchange(link, welcome, Leases(args.slots), children.look_after)
    children.start()
    spaces = exchange.wait_for_environment()
    networks = Networks.build(spaces, config)
    exchange.expected = Expected(spaces, networks.size, config.rollout.samples_per_slot)
    state = State.initial(networks, spaces.obs_size, config)
    chief = Chief(state, networks, config, 1, exchange, Ledger(config.rollout, lambda _: None))
    for _ in range(_WARM):
        chief.iterate()
    watch.reset()
    for _ in range(args.iterations):
        chief.iterate()
    _tell("learner", watch, absent)
    exchange.stop("the benchmark is over", final=True)
    children.wait()
    os._exit(0)


def _work(args: argparse.Namespace) -> None:
    """One worker; prints its seconds by label at the end."""
    from dppo.wire.socket_links import SocketWorkerLink
    from workers.core import Core
    from workers.envs import quiet
    from workers.membership import Member
    from workers.worker import Worker

    link = SocketWorkerLink(args.socket, orphaned=lambda: os._exit(0))
    quiet()
    watch = Stopwatch()
    absent = watch.put_on((*WORKER, *WIRE, *LINKS["Worker"]))
    perform = Worker.perform

    def begin_at_warm(worker: Worker, task: Any) -> None:  # noqa: ANN401  any task
        if task.iteration == _WARM and type(task).__name__ == "Collect":
            watch.reset()
        perform(worker, task)

    Worker.perform = begin_at_warm  # type: ignore[method-assign, assignment]
    Member(args.name, link, float("inf"), Core(args.core)).live()
    _tell(args.name, watch, absent)
    os._exit(0)


def _arguments() -> argparse.Namespace:
    parser = command_line(__doc__)
    parser.add_argument("--env", default="Ant-v4")
    parser.add_argument("--workers", type=int, default=len(usable_cores()))
    parser.add_argument("--slots", type=int, default=8)
    parser.add_argument("--iterations", type=int, default=10)
    parser.add_argument("--lead", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--socket", nargs="+", type=int, help=argparse.SUPPRESS)
    parser.add_argument("--name", default="", help=argparse.SUPPRESS)
    parser.add_argument("--core", type=int, default=-1, help=argparse.SUPPRESS)
    return parser.parse_args()


if __name__ == "__main__":
    main()
