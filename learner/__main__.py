"""`dppo-learner`: command line -> run directory, link, local workers -> session -> exit code."""

import contextlib
import socket
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from dppo.config import Config
from dppo.settings import require

if TYPE_CHECKING:
    from dppo.store.run_directory import RunDirectory
    from learner.replay import Original
    from learner.session import Session
    from learner.signals import StopSignals

_ALIASES = {
    "--env-id": "--env",
    "--n-envs": "--num-envs",
    "--n-steps": "--num-steps",
    "--n-epochs": "--update-epochs",
    "--lr": "--learning-rate",
    "--target-kl": "--kl-target",
    "--workers": "--local-workers",
    "-n": "--total-timesteps",
}
_WHOLE_NUMBERS = ("--total-timesteps", "--stop-at")


@dataclass(frozen=True, kw_only=True)
class ProcessArgs:
    """Where defaults come from, and this process; nothing here but preset changes the result."""

    preset: Literal["default", "paper", "authors-2019", "heess2017"] = "default"
    """Recipe that sets all defaults; flags win over it."""
    config: str = ""
    """JSON or TOML file that sets defaults, e.g. a run's config.json; flags win over it."""
    local_workers: int = -1
    """Worker processes to start here; 0: none, external ones connect; -1: one per core."""
    listen: str = "auto"
    """Zenoh address for workers, e.g. tcp/0.0.0.0:7447; auto: a free port on loopback."""
    insecure: bool = False
    """Allow listening beyond loopback, without encryption or authentication."""
    run_dir: str = ""
    """Folder of the run; empty: runs/<env>__<name>__psi<psi>__s<seed>__<time>."""
    name: str = "dppo"
    """Part of the default folder's name."""
    replay: str = ""
    """Run directory to run again by its ledger, to compare bits; see `dppo replay`."""
    resume: Literal["auto", "never"] = "auto"
    """With a run in --run-dir: continue it, or refuse."""
    checkpoint_every: int = 10
    """Iterations between checkpoints [count]."""
    keep_checkpoints: int = 3
    """Newest checkpoints to keep, besides the best [count]."""
    stop_at: int = sys.maxsize
    """Pause after so many environment steps of the run, with a checkpoint [env steps]."""
    patience: float = 3.0
    """Least silence, or time without progress, that a worker is given up for; inf: never [s]."""
    verbose: bool = False
    """Log who joins, leaves and waits."""

    def __post_init__(self) -> None:
        """Refuse what makes no sense."""
        leasts = {"local_workers": -1, "checkpoint_every": 1, "keep_checkpoints": 1}
        for name, least in leasts.items():
            require(getattr(self, name) >= least, name, getattr(self, name), f">= {least}")
        require(self.patience >= 1, "patience", self.patience, ">= 1")


@dataclass(frozen=True, kw_only=True)
class LearnerArgs(Config):
    """Train a policy with safe distributed PPO: same config and seed, same bits, however it runs.

    Needs nothing else: starts its own workers, shows progress, writes a run directory.
    """

    process: ProcessArgs = field(default_factory=ProcessArgs)


def main(argv: list[str] | None = None) -> None:
    """Run one learner; exit code 0: done or stopped, 1: failed, 2: wrong usage."""
    from dppo.process import leave, one_thread, parse, start_logging
    from learner.arguments import defaults, normalised

    one_thread()
    arguments = normalised(sys.argv[1:] if argv is None else argv, _ALIASES, _WHOLE_NUMBERS)

    def work() -> int:
        config = defaults(arguments)
        groups = {name: getattr(config, name) for name in Config.__dataclass_fields__}
        args = parse(LearnerArgs, arguments, "dppo-learner", LearnerArgs(**groups))
        start_logging(args.process.verbose)
        plain = Config(**{name: getattr(args, name) for name in Config.__dataclass_fields__})
        return _train(plain, args.process)

    leave(work)


def _train(config: Config, args: ProcessArgs) -> int:
    from dppo.process import usable_cores
    from dppo.store.run_directory import RunDirectory, default_path
    from dppo.wire.socket_links import Alarm, SocketLearnerLink
    from dppo.wire.zenoh_links import ZenohLearnerLink
    from learner.arguments import listening_address
    from learner.local import LocalWorkers
    from learner.replay import Original
    from learner.session import Session
    from learner.signals import StopSignals, log_to_file

    original = Original.read(Path(args.replay), config) if args.replay else None
    stop_at = args.stop_at
    if original is not None:
        stop_at = min(stop_at, len(original.iterations) * config.rollout.samples)
    address = listening_address(args.listen, args.insecure)
    alarm = Alarm()
    link = SocketLearnerLink(ZenohLearnerLink(address, alarm.ring), alarm)
    path = Path(args.run_dir) if args.run_dir else default_path(config, args.name)
    folder = RunDirectory.open(path)
    _check_resume(folder.has_run, path, "never" if original else args.resume)
    folder.check_config(config)
    log_to_file(path / "log.txt")
    signals = StopSignals()
    count = args.local_workers
    if count < 0:
        count = min(usable_cores(), config.rollout.slots)
    workers = LocalWorkers(link, count, args.verbose)

    def look_after() -> None:
        signals.check()
        workers.look_after()

    every, keep = args.checkpoint_every, args.keep_checkpoints
    session = Session(config, folder, link, look_after, every, keep, args.patience, original)
    _announce(config, path, address, count)
    try:
        workers.start()
        code = _run(session, signals, folder, stop_at)
        return code if original is None else _compared(session, original)
    finally:
        workers.end()
        link.close()
        folder.discard_unused()


def _run(session: "Session", signals: "StopSignals", folder: "RunDirectory", stop_at: int) -> int:
    """Train, and leave result.json and a checkpoint behind however it ends."""
    from dppo.errors import RunFailedError
    from dppo.process import Terminated

    try:
        result: dict[str, object] | None = session.train(stop_at)
    except Terminated:
        session.save()
        result = session.interrupted()
        print("stopped; the same command with this --run-dir continues" if result else "stopped")
    except RunFailedError as error:
        with contextlib.suppress(RunFailedError):  # the disk may be what failed
            session.save()
        failed = session.interrupted()
        if failed is not None:
            folder.write_json("result.json", failed | {"status": "failed", "reason": str(error)})
        raise
    signals.restore()
    if result is None:
        return 0
    folder.write_json("result.json", result)
    print(
        f"{result['status']}: {result['env_steps']:,} steps, parameters_sha256 "
        f"{result['parameters_sha256']}, see {folder.path / 'result.json'}",
        flush=True,
    )
    return 0


def _compared(session: "Session", original: "Original") -> int:
    """A replay is over, and nothing that it has reached differs."""
    done = 0 if session.state is None else session.state.iteration
    if done < len(original.iterations):
        whole = len(original.iterations)
        print(f"stopped after {done} of {whole} iterations: not compared to the end", flush=True)
        return 1
    print(original.verdict, flush=True)
    return 0


def _check_resume(has_run: bool, path: Path, resume: str) -> None:
    from dppo.errors import UsageError

    if has_run and resume == "never":
        raise UsageError(
            f"--run-dir {path} holds a run and --resume is never; give another folder, or "
            "--resume auto to continue it"
        )


def _announce(config: Config, path: Path, address: str, count: int) -> None:
    """The first lines: what runs where, and what psi means in it."""
    if address.startswith(("tcp/0.0.0.0:", "tcp/[::]:")):
        address = f"tcp/{socket.gethostname()}:{address.rpartition(':')[2]}"
    unit = "1" if config.safety.adv_norm == "separate" else "1/scaled reward"
    print(
        f"training {config.run.env}: {config.iterations} iterations of "
        f"{config.rollout.samples} steps in {config.rollout.slots} slots, "
        f"psi {config.safety.psi:g} (adv-norm {config.safety.adv_norm}, unit {unit}), "
        f"seed {config.run.seed}\n"
        f"run directory {path}; {count} local workers; others: dppo-worker --connect {address}",
        flush=True,
    )
    if not config.rollout.exact_envs:
        print("--no-exact-envs: after a loss or a resume this run is no longer exact", flush=True)
    if config.iterations == 1:
        print(
            "one iteration only fills the shared statistics: nothing will be learned", flush=True
        )


if __name__ == "__main__":
    main()
