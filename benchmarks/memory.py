"""Resident memory of every process of a run over time, and its slope.

    python -m benchmarks.memory --env Ant-v4 --minutes 60

The slope is a least-squares line through the samples after the first quarter, in which buffers
still fill. Long runs only: an hour resolves 1 MB/h, a minute does not.
"""

import argparse
import time
from pathlib import Path

import numpy as np

from benchmarks.measuring import Result, command_line, rss_mb, say, table
from benchmarks.processes import family
from benchmarks.runs import Run, dppo


def main() -> None:
    """Train for some minutes and sample."""
    args = _arguments()
    samples: dict[int, list[tuple[float, float]]] = {}
    names: dict[int, str] = {}
    with Run(dppo(args.env, steps=10**12)) as run:
        while time.time() - run.begun < 60 * args.minutes and run.process.poll() is None:
            time.sleep(args.interval)
            for pid in family(run.process.pid):
                samples.setdefault(pid, []).append((time.time() - run.begun, rss_mb(pid)))
                names.setdefault(pid, _name(pid))
    samples = {pid: found for pid, found in samples.items() if len(found) > 2}
    rows = [_row(names[pid], np.array(found)) for pid, found in samples.items()]
    for row, found in zip(rows, samples.values(), strict=True):
        say({"benchmark": "memory", "env": args.env, **row, "samples": found[:: args.thin]})
    table(rows)


def _name(pid: int) -> str:
    """Learner, or the worker's name."""
    try:
        words = Path(f"/proc/{pid}/cmdline").read_text().split("\0")
    except OSError:
        return str(pid)
    return words[words.index("--name") + 1] if "--name" in words else "learner"


def _row(name: str, samples: np.ndarray) -> Result:
    """First and last memory, slope after the first quarter [MB/h], over [minutes]."""
    seconds, megabytes = samples.T
    late = seconds >= seconds[0] + (seconds[-1] - seconds[0]) / 4
    slope = np.polyfit(seconds[late] / 3600, megabytes[late], 1)[0] if late.sum() > 1 else 0.0
    return {
        "process": name,
        "minutes": float(seconds[-1] - seconds[0]) / 60,
        "first_mb": float(megabytes[0]),
        "largest_mb": float(megabytes.max()),
        "last_mb": float(megabytes[-1]),
        "mb_per_hour": float(slope),
    }


def _arguments() -> argparse.Namespace:
    parser = command_line(__doc__)
    parser.add_argument("--env", default="Ant-v4")
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--interval", type=float, default=2.0, help="between samples [s]")
    parser.add_argument("--thin", type=int, default=30, help="print every so many samples")
    return parser.parse_args()


if __name__ == "__main__":
    main()
