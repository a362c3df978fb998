"""`dppo`: looks at what runs leave, replays, disturbs and compares them; measures; Four Rooms.

Training is `dppo-learner`.
"""

import json
import os
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, TypeVar

from dppo.arguments import RunFolder
from dppo.settings import require

_USAGE = (
    "usage: dppo {eval,export,video,watch,checkpoint,replay} RUN [options], or dppo "
    "{four-rooms,bench,chaos,experiment} [options]; --help after one of these says more"
)
_COMMANDS = """
RUN is a run directory of dppo-learner, or a checkpoint in it.

  eval        what its policy earns, how far that spreads, whether sigma knows
  export      the policy as ONNX or TorchScript
  video       a film of an episode
  watch       an episode in a window
  checkpoint  what is inside, with hashes
  replay      the run again by its ledger, to compare the bits
  four-rooms  the paper's tabular experiment
  bench       how fast this machine steps an environment, with advice
  chaos       a run with faults beside one without, to compare the bits
  experiment  a grid of runs, with a report

Training is dppo-learner; workers on other hosts are dppo-worker. All three take --version.

Exit codes: 0 done, 1 failed, 2 wrong usage, 130 or 143: a signal came before the result."""

_REPORTS = (["report"], ["keep"])
"""What `dppo experiment` does besides training a grid."""


class _OfRun(Protocol):
    """Arguments of a subcommand that looks at a run."""

    @property
    def run(self) -> str:
        """Run directory, or one checkpoint folder in it."""


Of = TypeVar("Of", bound=_OfRun)


@dataclass(frozen=True, kw_only=True)
class CheckpointArgs:
    """Show what is inside a run's checkpoints, with hashes."""

    run: RunFolder
    """Run directory, or one checkpoint folder in it."""
    which: str = "newest"
    """best, newest, or a checkpoint's name such as iteration-00000040."""


@dataclass(frozen=True, kw_only=True)
class ReplayArgs:
    """Run a run again by its ledger and compare the bits; exit code 1: they differ, and where.

    One that was stopped goes on with the same command.
    """

    run: RunFolder
    """Run directory."""
    out: str = ""
    """Folder for the second run; empty: replay, in the run directory."""
    local_workers: int = -1
    """Worker processes to start here; -1: one per core. No number changes the bits."""

    def __post_init__(self) -> None:
        """Refuse what cannot be run."""
        count = self.local_workers
        require(count == -1 or count >= 1, "local_workers", count, "-1 or >= 1")


@dataclass(frozen=True, kw_only=True)
class BenchArgs:
    """Measure how fast this machine steps an environment, against bare physics, with advice."""

    env: str = "Ant-v4"
    """Gymnasium environment id."""
    seconds: float = 2.0
    """Length of each of about eight measurements [s]."""
    json: bool = False
    """Print one line of JSON."""

    def __post_init__(self) -> None:
        """Refuse what cannot be run."""
        require(0 < self.seconds <= 60, "seconds", self.seconds, "0 < seconds <= 60")


def main(argv: list[str] | None = None) -> None:
    """Run one subcommand; exit code 1: failed, 2: wrong usage, 130, 143: stopped by a signal."""
    from dppo.machine import no_window, one_thread
    from dppo.process import leave

    one_thread()
    words = sys.argv[1:] if argv is None else argv
    if words[:1] not in (["video"], ["watch"]):
        no_window()
    leave(lambda: _command(words), delivers=not _is_open_ended(words))


def _is_open_ended(words: list[str]) -> bool:
    """Is nothing missing after Ctrl-C? Who watches is done then, and a grid goes on later."""
    return words[:1] == ["watch"] or (words[:1] == ["experiment"] and words[1:2] not in _REPORTS)


def _command(words: list[str]) -> int:
    from dppo.process import parse, start_logging

    start_logging(False)
    match words:
        case ["eval" | "export" | "video" | "watch" | "checkpoint" | "replay" as name, *rest]:
            return _with_run(name, rest)
        case ["four-rooms", *rest]:
            from dppo.four_rooms.command import FourRoomsArgs, run

            return run(parse(FourRoomsArgs, rest, "dppo four-rooms"))
        case ["bench", *rest]:
            return _bench(parse(BenchArgs, rest, "dppo bench"))
        case ["chaos", *rest]:
            from dppo.chaos import command as chaos

            own, learner_flags = chaos.split(rest)
            return chaos.run(parse(chaos.ChaosArgs, own, "dppo chaos"), learner_flags)
        case ["experiment", *rest]:
            from dppo.experiment import command as experiment

            return experiment.run(rest)
        case ["-h" | "--help", *_]:
            print(f"{_USAGE}\n{_COMMANDS}")
            return 0
        case ["--version", *_]:
            from dppo.sources import version_line

            print(version_line())
            return 0
    found = words[0] if words else "nothing"
    print(
        f"error: found {found}, expected eval, export, video, watch, checkpoint, replay, "
        f"four-rooms, bench, chaos or experiment\n"
        f"{_USAGE}",
        file=sys.stderr,
    )
    return 2


def _with_run(name: str, words: list[str]) -> int:
    """The subcommands that look at a run."""
    from workers.commands import evaluation, export, pictures

    match name:
        case "eval":
            return evaluation.run(_of_run(evaluation.EvalArgs, name, words))
        case "export":
            return export.run(_of_run(export.ExportArgs, name, words))
        case "video":
            return pictures.run_video(_of_run(pictures.VideoArgs, name, words))
        case "watch":
            return pictures.run_watch(_of_run(pictures.WatchArgs, name, words))
        case "checkpoint":
            return _checkpoint(_of_run(CheckpointArgs, name, words))
    return _replay(_of_run(ReplayArgs, name, words))


def _of_run(kind: type[Of], name: str, words: list[str]) -> Of:
    """The arguments of a subcommand that looks at a run.

    Raises:
        UsageError: one checkpoint is given, and which one to take besides.
    """
    from dppo.errors import UsageError
    from dppo.process import parse

    args = parse(kind, words, f"dppo {name}")
    from dppo.store.contents import is_checkpoint

    given = any(word.partition("=")[0] == "--which" for word in words)
    if given and is_checkpoint(Path(args.run)):
        raise UsageError(
            f"--which chooses among a run's checkpoints, but {args.run} is one of them; leave "
            "--which out, or give the run directory"
        )
    return args


def _checkpoint(args: CheckpointArgs) -> int:
    from dppo.networks import Networks
    from dppo.store.checkpoint import sha256
    from dppo.store.contents import chosen, config_in, spaces_in

    path, checkpoint = chosen(args.run, args.which)
    facts = checkpoint.facts
    parameters = checkpoint.arrays["parameters"]
    parts = Networks.build(spaces_in(checkpoint), config_in(checkpoint)).parts
    summary = {
        "path": str(path),
        "env": facts["config"]["run"]["env"],
        "seed": facts["config"]["run"]["seed"],
        "env_steps": facts["env_steps"],
        "made_by": facts.get("made_by"),
        "parameters_sha256": sha256(parameters),
        **{f"{name}_sha256": sha256(parameters[part]) for name, part in parts.items()},
        "state": facts["state"],
        "arrays": {
            name: f"{array.dtype} {list(array.shape)}"
            for name, array in sorted(checkpoint.arrays.items())
        },
    }
    print(json.dumps(summary, indent=2))
    return 0


def _replay(args: ReplayArgs) -> int:
    """Becomes a learner, which this package may not import: signals and exit code are its own.

    Raises:
        UsageError: there is no run.
    """
    from dppo.errors import UsageError
    from dppo.machine import own_program

    run = Path(args.run)
    out = Path(args.out) if args.out else run / "replay"
    for name in ("config.json", "ledger.jsonl"):
        if not (run / name).is_file():
            raise UsageError(
                f"{run} holds no {name}; expected a run directory of dppo-learner that has begun"
            )
    words = {"config": run / "config.json", "replay": run, "run-dir": out}
    flags = [word for name, value in words.items() for word in (f"--{name}", str(value))]
    flags += ["--local-workers", str(args.local_workers)]
    os.execv(sys.executable, own_program("learner", *flags))


def _bench(args: BenchArgs) -> int:
    from workers.bench import bench

    found = bench(args.env, args.seconds)
    if args.json:
        print(found.to_json())
        return 0
    for line in found.lines():
        print(line)
    for sentence in found.advice():
        print(f"- {sentence}")
    return 0


if __name__ == "__main__":
    main()
