"""Milliseconds of one update's round, by number of workers: ours, ZeroMQ, shared memory, gloo.

python -m benchmarks.exchange --workers 1 2 4 8 --python PEERS/bin/python
"""

import argparse
import sys

from benchmarks.exchange_cases import CASES
from benchmarks.measuring import Case, Result, SkippedError, interleaved, median, say, table


def main() -> None:
    """Measure every number of workers."""
    args = _arguments()
    table([_measured(workers, args) for workers in args.workers])


def _measured(workers: int, args: argparse.Namespace) -> Result:
    """One row: medians of the cases' medians."""
    cases, skipped = {}, {}
    words = str(workers), str(args.rounds)
    for name in args.cases:
        python = args.python if name == "zmq" else sys.executable
        try:
            cases[name] = Case("benchmarks.exchange_cases", name, *words, python=python)
        except SkippedError as error:
            skipped[name] = str(error)
    results = interleaved({name: case.measure for name, case in cases.items()}, args.repeats)
    for case in cases.values():
        case.close()
    times = {name: median(found, "ms") for name, found in results.items()}
    say(
        {
            "benchmark": "exchange", "workers": workers, "rounds": args.rounds, "ms": times,
            "p90_ms": {name: median(found, "p90_ms") for name, found in results.items()},
            "skipped": skipped, "all": results,
        }
    )  # fmt: skip
    ratio = times["dppo"] / times["zmq"] if {"dppo", "zmq"} <= times.keys() else None
    row: Result = {"workers": workers, **{f"{name}_ms": times.get(name) for name in args.cases}}
    return row | {"dppo/zmq": ratio}


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--workers", nargs="+", type=int, default=(1, 2, 4, 8))
    parser.add_argument("--cases", nargs="+", default=tuple(CASES), choices=tuple(CASES))
    parser.add_argument("--rounds", type=int, default=200, help="per repeat")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--python", default=sys.executable, help="interpreter that has pyzmq")
    return parser.parse_args()


if __name__ == "__main__":
    main()
