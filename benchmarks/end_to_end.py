"""Environment steps per second of whole training, ours and others', and as a share of raw physics.

    python -m benchmarks.end_to_end --env Ant-v4 --trainers dppo sb3 --python PEERS/bin/python

Raw is a bare `mj_step` loop on every core, before and after each trainer, on the states that an
untrained policy of ours leads through. A trainer's speed is counted in whole iterations, after the
first one; that leaves out start-up, and our first iteration, which does not learn.
"""

import argparse
import json
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.measuring import (
    ROOT,
    Case,
    Result,
    SkippedError,
    family,
    median,
    rss_mb,
    say,
    table,
    usable_cores,
)
from benchmarks.peers import TRAINERS
from benchmarks.recording import record

Row = dict[str, float]


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
        {"env": env, "trainer": name, **{figure: median(found, figure) for figure in figures}}
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


def command(trainer: str, env: str, marks: Path, python: str) -> list[str]:
    """The command line, as a user would give it; it appends to `marks` when it was where."""
    if trainer != "dppo":
        return [python, "-m", "benchmarks.peers", trainer, env, str(marks)]
    return [
        sys.executable, "-m", "learner", "--env", env, "--psi", "0.1", "--slots", "8",
        "--total-timesteps", "10000000", "--run-dir", str(marks.parent),
    ]  # fmt: skip


def _trained(trainer: str, env: str, args: argparse.Namespace) -> Result:
    """Start it, let it train for a while, end it."""
    with tempfile.TemporaryDirectory() as folder:
        marks = Path(folder) / "run" / "metrics.jsonl"
        if trainer != "dppo":
            marks.parent.mkdir()
        begun = time.time()
        process = subprocess.Popen(
            command(trainer, env, marks, _python(trainer, args)),
            cwd=ROOT,
            env=os.environ | {"PYTHONPATH": str(ROOT)},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        try:
            rows = _rows_of(process, marks, args.seconds)
            memory = sum(rss_mb(pid) for pid in family(process.pid))
        finally:
            end(process)
    first, last = rows[1], rows[-1]
    steps = last["time/total_timesteps"] - first["time/total_timesteps"]
    return {
        "steps_per_second": steps / (last["time"] - first["time"]),
        "iterations": len(rows) - 2,
        "first_step_seconds": rows[0]["time"] - begun,
        "memory_mb": memory,
    }


def _python(trainer: str, args: argparse.Namespace) -> str:
    """The interpreter that has this trainer."""
    other = args.sample_factory_python if trainer == "sample-factory" else ""
    return str(other or args.python)


def _rows_of(process: subprocess.Popen[str], marks: Path, seconds: float) -> list[Row]:
    """Rows at step 0, after the first iteration, and so on for at least `seconds` and 1 more."""
    rows: list[Row] = []
    while len(rows) < 3 or rows[-1]["time"] - rows[1]["time"] < seconds:
        if process.poll() is not None:
            assert process.stderr is not None
            words = process.stderr.read().strip().splitlines()
            raise SkippedError(words[-1] if words else f"it ended with code {process.returncode}")
        time.sleep(0.05)
        rows = read(marks)
    return rows


def read(marks: Path) -> list[Row]:
    """The whole lines so far, from step 0 on."""
    text = marks.read_text() if marks.exists() else ""
    rows = [json.loads(line) for line in text.splitlines(keepends=True) if line.endswith("\n")]
    if rows and rows[0]["time/total_timesteps"] > 0:  # dppo's first row ends its first iteration
        seconds = rows[0]["time/total_timesteps"] / rows[0]["charts/SPS"]
        rows.insert(0, {"time/total_timesteps": 0.0, "time": rows[0]["time"] - seconds})
    return rows


def end(process: subprocess.Popen[str]) -> None:
    """As a user would, and then for certain."""
    process.send_signal(signal.SIGTERM)
    try:
        process.communicate(timeout=10)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    names = ("dppo", *TRAINERS)
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
