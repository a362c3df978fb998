"""Environment steps per second of whole training, ours and others', and as a share of raw physics.

    python -m benchmarks.end_to_end --env Ant-v4 --trainers dppo sb3 --python PEERS/bin/python

Raw is a bare `mj_step` loop on every core, before and after each trainer, on the states that an
untrained policy of ours leads through. A trainer's speed is counted in whole iterations, after the
first one; that leaves out start-up, and our first iteration, which does not learn.
"""

import argparse
import statistics
import sys
import tempfile
from pathlib import Path

from benchmarks.measuring import Case, Result, command_line, say, spread, table, usable_cores
from benchmarks.peers import TRAINERS
from benchmarks.processes import SkippedError
from benchmarks.recording import record
from benchmarks.runs import Run, dppo, peer, speed

OURS = {
    "dppo": (),
    "dppo-full": ("--num-minibatches", "1", "--update-epochs", "10"),
}
"""Words behind the command; full: one minibatch per epoch, as the peers of that name."""


def main() -> None:
    """Measure every trainer on every environment."""
    args = _arguments()
    rows = []
    for env in args.env:
        rows += _compared(env, args)
    table(rows)


def _compared(env: str, args: argparse.Namespace) -> list[Result]:
    """A row per trainer; trainers and repeats interleaved."""
    results: dict[str, list[Result]] = {name: [] for name in args.trainers}
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "recording.npz"
        record(env, 16, "policy", 1.5).save(file)
        words = ("benchmarks.stepping_cases", "raw", str(file))
        cases = [Case(*words, core=core) for core in usable_cores()]
        before = _raw(cases)
        for _ in range(args.repeats):
            for name in args.trainers:
                try:
                    result = _trained(name, env, args)
                except SkippedError as error:
                    say({"benchmark": "end_to_end", "trainer": name, "skipped": str(error)})
                    continue
                after = _raw(cases)
                raw, before = (before + after) / 2, after
                result |= {"raw": raw, "ratio": result["steps_per_second"] / raw}
                results[name].append(result)
                say({"benchmark": "end_to_end", "env": env, "trainer": name, **result})
        for case in cases:
            case.close()
    figures = ("steps_per_second", "raw", "ratio", "first_step_seconds", "memory_mb")
    return [
        {"env": env, "trainer": name, **{figure: spread(found, figure) for figure in figures}}
        for name, found in results.items()
        if found
    ]


def _raw(cases: list[Case]) -> float:
    """Steps per second of the bare loop on all cores at the same time."""
    speeds = []
    for _ in range(2):
        for case in cases:
            case.go()
        speeds.append(sum(float(case.finish()["steps_per_second"]) for case in cases))
    return statistics.mean(speeds)


def _trained(trainer: str, env: str, args: argparse.Namespace) -> Result:
    """Start it, let it train for a while, end it."""
    python = _python(trainer, args)
    ours = trainer in OURS
    command = dppo(env, *OURS[trainer]) if ours else peer(trainer, env, python)
    with Run(command) as run:
        rows = run.trained(args.seconds)
        return {
            "steps_per_second": speed(rows),
            "iterations": len(rows) - 2,
            "first_step_seconds": rows[0]["time"] - run.begun,
            "memory_mb": run.memory_mb,
        }


def _python(trainer: str, args: argparse.Namespace) -> str:
    """The interpreter that has this trainer."""
    other = args.sample_factory_python if trainer == "sample-factory" else ""
    return str(other or args.python)


def _arguments() -> argparse.Namespace:
    parser = command_line(__doc__)
    names = (*OURS, *TRAINERS)
    parser.add_argument("--env", nargs="+", default=("Ant-v4", "HalfCheetah-v4"))
    parser.add_argument("--trainers", nargs="+", default=names, choices=names)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=15.0, help="of each, after iteration 1")
    parser.add_argument("--python", default=sys.executable, help="interpreter that has the peers")
    parser.add_argument(
        "--sample-factory-python", default="", help="its own interpreter: it wants gymnasium < 1"
    )
    return parser.parse_args()


if __name__ == "__main__":
    main()
