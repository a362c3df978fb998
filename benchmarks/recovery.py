"""What a fault costs: seconds lost, against what the run had to do again anyway.

    python -m benchmarks.recovery --env Hopper-v5

    worker killed     two workers; one dies somewhere in an iteration. Lost: how much longer that
                      iteration took than the median, less what one worker takes for the slots of
                      the other (half of an iteration of one worker alone)
    learner killed    from the kill until an iteration is logged that had not been logged before,
                      with a checkpoint every iteration
    worker stopped    two slots, three workers, one of them a spare; one that works is stopped for
                      ever. Speed after the deadline against the speed before

Real processes over loopback, as in `dppo chaos`.
"""

import itertools
import json
import statistics
import tempfile
from pathlib import Path

from benchmarks.measuring import Result, command_line, interleaved, say, table
from dppo.chaos.cast import Setup
from dppo.chaos.drill import ByIteration, Drill
from dppo.chaos.outcome import Outcome
from dppo.chaos.plan import Fault, Plan

_DEADLINE = 6.0
"""Transport's lease and patience together, with what the heirs do again [s]."""
_STOP_AT = 60


def main() -> None:
    """Measure the three, interleaved."""
    parser = command_line(__doc__)
    parser.add_argument("--env", default="Hopper-v5", help="environment id (default: Hopper-v5)")
    parser.add_argument("--repeats", type=int, default=3, help="default: 3")
    args = parser.parse_args()
    env = args.env
    cases = {
        "worker killed": lambda: _worker_killed(env),
        "learner killed": lambda: _learner_killed(env),
        "worker stopped, a spare there": lambda: _worker_stopped(env),
    }
    rows = []
    for name, found in interleaved(cases, args.repeats).items():
        figures = {key: statistics.median(one[key] for one in found) for key in found[0]}
        say({"benchmark": "recovery", "env": env, "case": name, **figures, "all": found})
        rows.append({"case": name, **dict.fromkeys(_FIGURES), **figures})
    table(rows)


_FIGURES = ("iteration_s", "recovered_s", "redo_s", "lost_beyond_redo_s", "speed_after")


def _worker_killed(env: str) -> Result:
    alone, _ = _drilled(env, 12, workers=1)
    kills = [Fault(at, "kill-worker", f"w{at % 2}") for at in range(10, 50, 8)]
    outcome, _ = _drilled(env, 60, *kills, workers=2)
    redo = alone.median / 2
    recovered = statistics.median(_recovered(outcome))
    return {
        "iteration_s": outcome.median,
        "recovered_s": recovered,
        "redo_s": redo,
        "lost_beyond_redo_s": recovered - outcome.median - redo,
    }


def _learner_killed(env: str) -> Result:
    kills = [Fault(at, "kill-learner", "learner") for at in (10, 25, 40)]
    outcome, _ = _drilled(env, 50, *kills, flags=("--checkpoint-every", "1"), workers=2)
    return {
        "iteration_s": outcome.median,
        "recovered_s": statistics.median(_recovered(outcome)),
    }


def _worker_stopped(env: str) -> Result:
    spare, stop = Fault(5, "join-worker", "x0"), Fault(_STOP_AT, "stop-worker", "w0")
    _, times = _drilled(env, 200, spare, stop, flags=("--slots", "2"), workers=2)
    stopped = times[_STOP_AT - 1]
    before = _seconds_per_iteration([at for at in times if at <= stopped][20:])
    after = _seconds_per_iteration([at for at in times if at > stopped + _DEADLINE])
    return {"iteration_s": before, "speed_after": before / after}


def _drilled(
    env: str, iterations: int, *faults: Fault, flags: tuple[str, ...] = (), workers: int
) -> tuple[Outcome, list[float]]:
    """A run with faults, and when each of its iterations was logged [s]."""
    steps = "64" if flags[:1] == ("--slots",) else "256"
    samples = int(steps) * 8 * (2 if flags[:1] == ("--slots",) else 8)
    run = (
        "--env", env, "--num-envs", "8", "--num-steps", steps,
        "--total-timesteps", str(iterations * samples), *flags,
    )  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder)
        outcome = Drill(Setup(run, 0, workers), ByIteration(Plan(faults)), path).run()
        if outcome.problem:
            raise RuntimeError(outcome.problem)
        lines = (path / "run" / "metrics.jsonl").read_text().splitlines()
    return outcome, [json.loads(line)["time"] for line in lines]


def _recovered(outcome: Outcome) -> list[float]:
    return [one.recovered for one in outcome.faults if one.recovered is not None]


def _seconds_per_iteration(times: list[float]) -> float:
    return statistics.median(after - before for before, after in itertools.pairwise(times))


if __name__ == "__main__":
    main()
