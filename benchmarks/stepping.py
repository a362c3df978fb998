"""Environment steps per second of one core: raw `mj_step`, gymnasium, EnvPool and ours.

    python -m benchmarks.stepping --env Ant-v4 HalfCheetah-v5 --python PEERS/bin/python

All cases step the same recorded actions, and all but EnvPool through the same states.
"""

import argparse
import sys
import tempfile
from pathlib import Path

from benchmarks.measuring import (
    Case,
    Result,
    command_line,
    interleaved,
    median,
    say,
    table,
    usable_cores,
)
from benchmarks.processes import SkippedError
from benchmarks.recording import ActionKind, record
from benchmarks.stepping_cases import CASES

_BODIES = (
    "Ant", "HalfCheetah", "Hopper", "Walker2d", "Humanoid", "HumanoidStandup", "Swimmer",
    "InvertedPendulum", "InvertedDoublePendulum", "Reacher", "Pusher",
)  # fmt: skip
ENVS = tuple(f"{body}-{version}" for body in _BODIES for version in ("v4", "v5"))


def main() -> None:
    """Measure every environment with every kind of actions."""
    args = _arguments()
    rows = []
    for env in args.env:
        for actions in args.actions:
            rows.append(_measured(env, actions, args))
    table(rows)


def _measured(env: str, actions: ActionKind, args: argparse.Namespace) -> Result:
    """One row: the cases' speeds, interleaved, and their ratios to raw."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "recording.npz"
        recording = record(env, args.num_envs, actions, args.seconds)
        recording.save(file)
        cases, skipped = {}, {}
        for name in args.cases:
            python = args.python if name == "envpool" else sys.executable
            try:
                cases[name] = Case(
                    "benchmarks.stepping_cases", name, str(file), python=python, core=args.core
                )
            except SkippedError as error:
                skipped[name] = str(error)
        results = interleaved({name: case.measure for name, case in cases.items()}, args.repeats)
        for case in cases.values():
            case.close()
    speeds = {name: median(found, "steps_per_second") for name, found in results.items()}
    same = {name: found[0]["same"] for name, found in results.items() if "same" in found[0]}
    say(
        {
            "benchmark": "stepping", "env": env, "actions": actions, "num_envs": args.num_envs,
            "steps": recording.steps, "resets": int(recording.ended.sum()),
            "steps_per_second": speeds, "same_states": same, "skipped": skipped,
            "all": results,
        }
    )  # fmt: skip
    ratios = {f"{name}/raw": speeds[name] / speeds["raw"] for name in speeds if name != "raw"}
    return {"env": env, "actions": actions, "raw": speeds["raw"], **ratios}


def _arguments() -> argparse.Namespace:
    parser = command_line(__doc__)
    parser.add_argument("--env", nargs="+", default=ENVS, help="Gymnasium ids")
    parser.add_argument("--actions", nargs="+", default=("mild", "random"))
    parser.add_argument("--cases", nargs="+", default=tuple(CASES), choices=tuple(CASES))
    parser.add_argument("--num-envs", type=int, default=16)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=0.7, help="length of the recording")
    parser.add_argument("--core", type=int, default=usable_cores()[-1])
    parser.add_argument("--python", default=sys.executable, help="interpreter that has EnvPool")
    return parser.parse_args()


if __name__ == "__main__":
    main()
