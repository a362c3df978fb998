"""`dppo chaos`: an undisturbed run, the same run with faults, and whether their bits agree."""

import contextlib
import json
import shutil
from collections.abc import Iterator
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

from dppo.chaos.cast import Setup
from dppo.chaos.drill import ByClock, ByIteration, Drill
from dppo.chaos.outcome import Outcome
from dppo.chaos.plan import KINDS, Fault, Plan
from dppo.errors import RunFailedError, UsageError
from dppo.files import safe_name
from dppo.settings import require

_SMALL = (
    "--slots", "8", "--num-envs", "1", "--num-steps", "64", "--update-epochs", "2",
    "--num-minibatches", "2", "--psi", "0.1", "--checkpoint-every", "5",
)  # fmt: skip
"""A run whose iterations take a fraction of a second; flags after `--` win over it."""
_STEPS = 8 * 64
_ITERATIONS_PER_FAULT = 10
_ENDLESS = str(10**12)
"""Steps of a soak: more than it can make."""
_OURS = ("--run-dir", "--listen", "--local-workers", "--workers", "--env", "--env-id")
_FAR = 10**9
_RUNS = ("undisturbed", "disturbed")


@dataclass(frozen=True, kw_only=True)
class ChaosArgs:
    """Kill, stop, cut and corrupt a real run; see that it ends with the bits of a quiet one.

    Flags after -- go to the learner, e.g. -- --psi 0.2 --total-timesteps 1e6. Without them the run
    is a small one.
    """

    env: str = "Hopper-v5"
    """Gymnasium environment id."""
    faults: int = 20
    """Faults to draw, each kind once before any comes twice [count]."""
    seed: int = 0
    """Of the plan; the run's own is -- --seed."""
    local_workers: int = 1
    """Workers that the learner starts [count]."""
    workers: int = 2
    """External workers, each behind a proxy [count]."""
    kinds: str = ""
    """Kinds of faults to draw, with commas between; empty: all."""
    plan: str = ""
    """JSON file with the faults, instead of drawing them."""
    plan_only: bool = False
    """Print the plan and end."""
    minutes: float = 0.0
    """Soak: train and disturb for so long, however many iterations that makes; 0: not [min]."""
    every: float = 20.0
    """Soak: time from one fault to the next [s]."""
    patience: float = 120.0
    """Longest wait for the next iteration [s]."""
    out: str = ""
    """Folder for both runs and everybody's output; empty: runs/chaos-<env>-<UTC time>."""
    json: bool = False
    """Print JSON."""

    def __post_init__(self) -> None:
        """Refuse what cannot be run."""
        for name in ("faults", "local_workers", "workers", "seed", "minutes"):
            require(getattr(self, name) >= 0, name, getattr(self, name), ">= 0")
        for name in ("every", "patience"):
            require(getattr(self, name) > 0, name, getattr(self, name), "> 0")
        require(
            self.local_workers + self.workers > 0, "workers", 0, ">= 1, or --local-workers >= 1"
        )
        for kind in self.chosen:
            require(kind in KINDS, "kinds", repr(kind), f"some of {', '.join(KINDS)}")
        require(not (self.plan and self.minutes), "plan", self.plan, "no plan with --minutes")

    @property
    def chosen(self) -> tuple[str, ...]:
        """Kinds to draw from."""
        return tuple(self.kinds.split(",")) if self.kinds else KINDS


def split(words: list[str]) -> tuple[list[str], tuple[str, ...]]:
    """Our own flags, and those after `--` for the learner.

    Raises:
        UsageError: the learner would get a flag that is ours to give.
    """
    at = words.index("--") if "--" in words else len(words)
    theirs = tuple(words[at + 1 :])
    for word in theirs:
        flag = word.partition("=")[0].replace("_", "-")
        if flag in _OURS:
            raise UsageError(
                f"{flag} stands after --, but dppo chaos gives it to the learner itself; leave it "
                "out there, and put --env, --workers or --local-workers before --"
            )
    return words[:at], theirs


def run(args: ChaosArgs, learner_flags: tuple[str, ...]) -> int:
    """Both runs; exit code 0: the disturbed one finished, and with no drop has the same bits.

    Raises:
        UsageError: the plan, the learner's flags or the folder is of no use; nothing is left.
        RunFailedError: the undisturbed run fails.
    """
    if args.plan_only and not args.plan:
        print(_drawn(args, args.faults * _ITERATIONS_PER_FAULT + 10).to_json(), end="")
        return 0
    plan = Plan.read(Path(args.plan)) if args.plan else None
    if args.plan_only and plan is not None:
        print(plan.to_json(), end="")
        return 0
    folder, is_ours = _new_folder(args)
    try:
        quiet, disturbed = (
            _soak(args, learner_flags, folder)
            if args.minutes
            else _compare(args, learner_flags, folder, plan)
        )
    except UsageError:  # the corrected command will want this folder
        _clear(folder, is_ours)
        raise
    report = {
        "same_bits": quiet.sha256 == disturbed.sha256 != "",
        "undisturbed": quiet.to_dict(),
        "disturbed": disturbed.to_dict(),
    }
    (folder / "chaos.json").write_text(json.dumps(report, indent=1) + "\n")
    ended = not disturbed.problem and not disturbed.left_behind
    good = ended and (report["same_bits"] or not disturbed.exact)
    if args.json:
        print(json.dumps(report))
    else:
        from dppo.chaos.console import show

        show(quiet, disturbed, folder)
    return 0 if good else 1


def _compare(
    args: ChaosArgs, flags: tuple[str, ...], folder: Path, plan: Plan | None
) -> tuple[Outcome, Outcome]:
    """First the undisturbed run: it tells how many iterations there are."""
    last = max((fault.at for fault in plan.faults), default=0) if plan else 0
    steps = max(args.faults * _ITERATIONS_PER_FAULT, last) * _STEPS + 10 * _STEPS
    all_flags = ("--env", args.env, *_SMALL, "--total-timesteps", str(steps), *flags)
    quiet = _undisturbed(args, all_flags, folder)
    if plan is None:
        plan = _drawn(args, quiet.iterations)
    plan.check(iterations=quiet.iterations, workers=args.workers, local_workers=args.local_workers)
    (folder / "plan.json").write_text(plan.to_json())
    setup = Setup(all_flags, args.local_workers, args.workers)
    schedule = ByIteration(plan, args.patience)
    return quiet, Drill(setup, schedule, folder / "disturbed", args.seed).run()


def _soak(args: ChaosArgs, flags: tuple[str, ...], folder: Path) -> tuple[Outcome, Outcome]:
    """First the disturbed run: the undisturbed one stops where that did."""
    all_flags = ("--env", args.env, *_SMALL, "--total-timesteps", _ENDLESS, *flags)
    schedule = ByClock(_endless(args), args.every, 60 * args.minutes, args.patience)
    setup = Setup(all_flags, args.local_workers, args.workers)
    disturbed = Drill(setup, schedule, folder / "disturbed", args.seed).run()
    if disturbed.problem or not disturbed.steps:
        return Outcome(), disturbed
    stop = ("--stop-at", str(disturbed.steps))
    return _undisturbed(args, (*all_flags, *stop), folder), disturbed


def _undisturbed(args: ChaosArgs, flags: tuple[str, ...], folder: Path) -> Outcome:
    setup = Setup(flags, max(1, args.local_workers + args.workers), 0)
    quiet = Drill(setup, ByIteration(Plan(()), args.patience), folder / "undisturbed").run()
    if quiet.problem:
        raise RunFailedError(f"the undisturbed run failed: {quiet.problem}")
    return quiet


def _drawn(args: ChaosArgs, iterations: int) -> Plan:
    try:
        return Plan.seeded(
            args.seed,
            faults=args.faults,
            iterations=iterations,
            workers=args.workers,
            local_workers=args.local_workers,
            kinds=args.chosen,
        )
    except ValueError as error:
        raise UsageError(str(error)) from error


def _endless(args: ChaosArgs) -> Iterator[Fault]:
    """Faults for a soak, in rounds in which each kind comes once."""
    for turn in range(_FAR):
        turns = replace(args, seed=args.seed + turn, faults=len(args.chosen))
        yield from _drawn(turns, _FAR).faults


def _new_folder(args: ChaosArgs) -> tuple[Path, bool]:
    """The folder of this drill, with one for each run; and whether it was made here.

    Raises:
        UsageError: it cannot be written, or holds something.
    """
    now = datetime.now(UTC).strftime("%Y%m%dT%H%M%S")
    folder = Path(args.out or f"runs/chaos-{safe_name(args.env)}-{now}")
    try:
        is_ours = not folder.exists()
        if not is_ours and any(folder.iterdir()):
            raise UsageError(f"--out {folder} holds something already; give a new folder")
        for name in _RUNS:
            (folder / name).mkdir(parents=True)
    except OSError as error:
        raise UsageError(
            f"--out {folder} cannot be written: {error.strerror}; give a folder of yours"
        ) from error
    return folder, is_ours


def _clear(folder: Path, is_ours: bool) -> None:
    """Leave the folder as it was found: empty, or not there."""
    for name in _RUNS:
        shutil.rmtree(folder / name, ignore_errors=True)
    with contextlib.suppress(OSError):
        (folder / "plan.json").unlink(missing_ok=True)
        if is_ours:
            folder.rmdir()
