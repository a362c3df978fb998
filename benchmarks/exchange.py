"""Milliseconds of one update's round by number of workers: socket pairs, Zenoh, and others.

python -m benchmarks.exchange --workers 1 2 4 8 --python PEERS/bin/python
"""

import argparse
import sys

from benchmarks.exchange_cases import CASES
from benchmarks.measuring import Case, Result, command_line, interleaved, median, say, table
from benchmarks.processes import SkippedError


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
    row: Result = {"workers": workers, **{f"{name}_ms": times.get(name) for name in args.cases}}
    for one, other in (("pairs", "zenoh"), ("pairs", "zmq")):
        both = {one, other} <= times.keys()
        row[f"{one}/{other}"] = times[one] / times[other] if both else None
    return row


def _arguments() -> argparse.Namespace:
    parser = command_line(__doc__)
    parser.add_argument("--workers", nargs="+", type=int, default=(1, 2, 4, 8))
    parser.add_argument("--cases", nargs="+", default=tuple(CASES), choices=tuple(CASES))
    parser.add_argument("--rounds", type=int, default=200, help="per repeat")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--python", default=sys.executable, help="interpreter that has pyzmq")
    return parser.parse_args()


if __name__ == "__main__":
    main()
