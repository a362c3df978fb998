"""Training speed by number of worker processes, and the chief's cost per update by workers.

    python -m benchmarks.scaling --env Ant-v4 --workers 1 2 --slots 8 64 256

The first table trains as a user does. The second has one worker per slot, each a puppet that
answers with a gradient made beforehand over the in-memory link: what is left is the chief's own
time, messages decoded and encoded included.
"""

import argparse
import json
from dataclasses import replace

from benchmarks.measuring import (
    Result,
    command_line,
    interleaved,
    median,
    say,
    table,
    usable_cores,
)
from benchmarks.puppets import SPACES, Puppet, config_of, networks_of
from benchmarks.runs import Run, dppo, speed
from benchmarks.stopwatch import REST, Place, Stopwatch
from dppo.leases import Leases
from dppo.wire.links import Refused, WorkerLost
from dppo.wire.memory_links import MemoryHub, MemoryLearnerLink, MemoryWorkerLink
from dppo.wire.messages import ToLearner, ToWorker, Welcome
from learner.chief import Chief
from learner.exchange import Exchange
from learner.ledger import Ledger
from learner.soundness import Expected
from learner.state import State

CHIEF: tuple[Place, ...] = (
    ("dppo.wire.memory_links:encode", "encode"),
    ("dppo.wire.inbox:decode", "decode"),
    ("learner.exchange:Exchange.gather", "rounds"),
    ("learner.chief:block_sum", "sums"),
    ("learner.chief:Chief._change", "Adam"),
)


def main() -> None:
    """Both tables."""
    args = _arguments()
    rows = _processes(args) if args.workers else []
    watch = Stopwatch()
    watch.put_on(CHIEF)
    cost = [_chief(slots, args.iterations, watch) for slots in args.slots]
    table(rows)
    table(cost)


def _processes(args: argparse.Namespace) -> list[Result]:
    """Real runs, interleaved."""

    def trained(workers: int) -> Result:
        with Run(dppo(args.env, "--local-workers", str(workers))) as run:
            return {"steps_per_second": speed(run.trained(args.seconds))}

    runs = {str(number): lambda n=number: trained(n) for number in args.workers}
    results = interleaved(runs, args.repeats)
    speeds = {number: median(found, "steps_per_second") for number, found in results.items()}
    first = next(iter(speeds.values()))
    rows = [
        {"env": args.env, "workers": int(number), "steps_per_second": value, "gain": value / first}
        for number, value in speeds.items()
    ]
    for row in rows:
        say({"benchmark": "scaling", **row})
    return rows


class PuppetLink:
    """A `LearnerLink` whose workers answer within `send`, off the watch."""

    def __init__(self, count: int, size: int, watch: Stopwatch) -> None:
        hub = MemoryHub()
        self._link: MemoryLearnerLink = hub.learner()
        self._puppets = [Puppet(f"puppet-{number}", size) for number in range(count)]
        self._ends: dict[str, tuple[Puppet, MemoryWorkerLink]] = {
            puppet.name: (puppet, hub.worker(puppet.name)) for puppet in self._puppets
        }
        self._watch = watch
        for puppet, end in self._ends.values():
            end.send(puppet.hello())

    def receive(self, timeout: float) -> ToLearner | WorkerLost | Refused | None:
        """See `LearnerLink`."""
        return self._link.receive(timeout)

    def send(self, worker: str, message: ToWorker) -> None:
        """See `LearnerLink`."""
        self._link.send(worker, message)
        self._watch.switch("puppets")
        puppet, end = self._ends[worker]
        end.receive(0.0)
        for answer in puppet.answers(message):
            end.send(answer)
        self._watch.switch(None)

    def cut(self, worker: str) -> None:
        """See `LearnerLink`."""
        self._link.cut(worker)

    def close(self) -> None:
        """See `LearnerLink`."""
        self._link.close()


def _chief(slots: int, iterations: int, watch: Stopwatch) -> Result:
    """Milliseconds of the chief per update, by what it does."""
    config = config_of(slots)
    total = config.rollout.samples * (iterations + 2) * 10
    config = replace(config, run=replace(config.run, total_timesteps=total))
    networks = networks_of(config)
    welcome = Welcome(run="scaling", generation=1, config=json.dumps(config.to_dict()))
    link = PuppetLink(slots, networks.size, watch)
    exchange = Exchange(link, welcome, Leases(slots), lambda: None)
    exchange.expected = Expected(SPACES, networks.size, config.rollout.samples_per_slot)
    exchange.wait_for_environment()
    state = State.initial(networks, SPACES.obs_size, config)
    chief = Chief(state, networks, config, 1, exchange, Ledger(config.rollout, lambda _: None))
    while exchange.num_workers < slots:
        chief.iterate()
    chief.iterate()  # slots are spread over all of them at its beginning
    watch.reset()
    for _ in range(iterations):
        chief.iterate()
    updates = iterations * config.update.updates
    spent = {label: 1000 * seconds / updates for label, seconds in watch.read().items()}
    spent.pop("puppets")
    row: Result = {"workers": slots, "ms_per_update": sum(spent.values())}
    row["us_per_worker"] = 1000 * row["ms_per_update"] / slots
    parts = {label: spent.get(label, 0.0) for label in (*(label for _, label in CHIEF), REST)}
    say({"benchmark": "scaling", "what": "chief", **row, "ms": parts})
    return row | {f"{label}_ms": value for label, value in parts.items()}


def _arguments() -> argparse.Namespace:
    parser = command_line(__doc__)
    parser.add_argument("--env", default="Ant-v4")
    cores = len(usable_cores())
    parser.add_argument("--workers", nargs="*", type=int, default=tuple(range(1, cores + 1)))
    parser.add_argument("--slots", nargs="*", type=int, default=(1, 8, 32, 64, 128, 256))
    parser.add_argument("--iterations", type=int, default=2, help="of the chief, timed")
    parser.add_argument("--seconds", type=float, default=8.0, help="of each run")
    parser.add_argument("--repeats", type=int, default=3)
    return parser.parse_args()


if __name__ == "__main__":
    main()
