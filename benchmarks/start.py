"""Seconds from the command to the first environment step and to the first line of progress.

    python -m benchmarks.start --env Ant-v4

The first environment step of any slot lies between `asked` (the learner has sent the first
question) and `collected` (all slots have run their first steps, 2048 together). Nothing is
patched: both follow from the run's own metrics.jsonl.
"""

import argparse
import subprocess
import sys
import time

from benchmarks.measuring import Result, command_line, interleaved, median, say, table
from benchmarks.processes import ROOT
from benchmarks.runs import TIME, Run, dppo

_DEADLINE = 120.0


def main() -> None:
    """Measure starts and `--help`, interleaved."""
    args = _arguments()
    measurements = {"help": _help} | {env: lambda env=env: _started(env) for env in args.env}
    results = interleaved(measurements, args.repeats)
    rows = []
    for name, found in results.items():
        figures = {figure: median(found, figure) for figure in found[0]}
        say({"benchmark": "start", "what": name, **figures, "all": found})
        rows.append({"what": name, **dict.fromkeys(_FIGURES), **figures})
    table(rows)


_FIGURES = ("seconds", "announced", "asked", "collected", "progress")


def _help() -> Result:
    """`dppo-learner --help`."""
    begun = time.time()
    words = [sys.executable, "-m", "learner", "--help"]
    subprocess.run(words, cwd=ROOT, capture_output=True, check=True)
    return {"seconds": time.time() - begun}


def _started(env: str) -> Result:
    """Times since the command, until the first line of progress."""
    announced = None
    with Run(dppo(env)) as run:
        while time.time() - run.begun < _DEADLINE:
            time.sleep(0.01)
            text = run.output.read_text()
            if announced is None and text:
                announced = time.time() - run.begun
            if "steps  left" in text:
                break
        else:
            raise TimeoutError(f"no progress within {_DEADLINE:g} s: {text}")
        progress, rows = time.time() - run.begun, run.rows()
    return {
        "announced": announced,
        "asked": rows[0][TIME] - run.begun,
        "collected": rows[1][TIME] - run.begun,
        "progress": progress,
    }


def _arguments() -> argparse.Namespace:
    parser = command_line(__doc__)
    parser.add_argument("--env", nargs="+", default=("Ant-v4",))
    parser.add_argument("--repeats", type=int, default=5)
    return parser.parse_args()


if __name__ == "__main__":
    main()
