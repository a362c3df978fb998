"""`dppo-learner`: command line -> run directory, link, local workers -> session -> exit code."""

import os
import socket
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NoReturn

from dppo.config import Config
from dppo.process import say
from dppo.settings import require

if TYPE_CHECKING:
    from dppo.store.run_directory import RunDirectory
    from learner.replay import Original
    from learner.session import Session

_ALIASES = {
    "--env-id": "--env",
    "--n-envs": "--num-envs",
    "--n-steps": "--num-steps",
    "--n-epochs": "--update-epochs",
    "--lr": "--learning-rate",
    "--target-kl": "--kl-target",
    "-n": "--total-timesteps",
}
_SETUP_SECONDS = 60.0
"""A worker that makes its environments may be silent for so long."""
_WHOLE_NUMBERS = ("--total-timesteps", "--stop-at")


@dataclass(frozen=True, kw_only=True)
class ProcessArgs:
    """Where defaults come from, and this process; only preset, config, replay change results."""

    preset: Literal["default", "paper", "authors-2019", "heess2017"] = "default"
    """Recipe that sets all defaults; flags win over it."""
    config: str = ""
    """JSON or TOML file that sets defaults, e.g. a run's config.json; flags win over it."""
    local_workers: int = -1
    """Worker processes to start here; 0: none, others connect; -1: one per core, or per slot."""
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
    stop_at: int = 0
    """Pause after so many environment steps of the run, with a checkpoint; 0: never [steps]."""
    patience: float = 3.0
    """Least silence, or time without progress, that a worker is given up for; inf: never [s]."""
    restarts: int = 0
    """Start the learner again when it dies or fails, at most so many times in all [count]."""
    verbose: bool = False
    """Log who joins, leaves and waits."""

    def __post_init__(self) -> None:
        """Refuse what makes no sense."""
        leasts = {
            "local_workers": -1, "checkpoint_every": 1, "keep_checkpoints": 1, "restarts": 0,
            "stop_at": 0,
        }  # fmt: skip
        for name, least in leasts.items():
            require(getattr(self, name) >= least, name, getattr(self, name), f">= {least}")
        require(self.patience >= 1, "patience", self.patience, ">= 1")
        require("/" not in self.name, "name", repr(self.name), "no '/': it is part of a folder's")


@dataclass(frozen=True, kw_only=True)
class LearnerArgs(Config):
    """Train a policy with safe distributed PPO: same config and seed, same bits, however it runs.

    Needs nothing else: starts its own workers, shows progress, writes a run directory. --version
    says which code this is.
    """

    process: ProcessArgs = field(default_factory=ProcessArgs)


def main(argv: list[str] | None = None) -> None:
    """Run one learner; exit code 0: done or stopped, 1: failed, 2: wrong usage."""
    from dppo.machine import one_thread
    from dppo.process import leave, parse, start_logging
    from learner.arguments import defaults, normalised

    one_thread()
    words = sys.argv[1:] if argv is None else argv
    supervisor = None
    if words[:1] == ["--supervised"] and words[1:2] != [] and words[1].isdecimal():
        supervisor, words = int(words[1]), words[2:]  # from a supervisor or an experiment
    arguments = normalised(words, _ALIASES, _WHOLE_NUMBERS)

    def work() -> int:
        config = defaults(arguments)
        groups = {name: getattr(config, name) for name in Config.__dataclass_fields__}
        args = parse(LearnerArgs, arguments, "dppo-learner", LearnerArgs(**groups))
        plain = Config(**{name: getattr(args, name) for name in Config.__dataclass_fields__})
        if args.process.restarts and supervisor is None:
            _become_supervisor(plain, args.process, arguments)
        start_logging(args.process.verbose)
        return _train(plain, args.process, supervisor)

    leave(work)


def _become_supervisor(config: Config, args: ProcessArgs, arguments: list[str]) -> NoReturn:
    """Go on as the supervisor: a new program, because this one has loaded too much for a guard.

    Folder and address are settled here, so that every start has the same ones.
    """
    from dppo.machine import own_program
    from dppo.store.run_directory import default_path
    from learner.arguments import listening_address

    path = args.run_dir or str(default_path(config, args.name))
    address = listening_address(args.listen, args.insecure)
    settled = ["--run-dir", path, "--listen", address]
    program = own_program("learner.supervisor", str(args.restarts), *arguments, *settled)
    os.execv(sys.executable, program)


def _train(config: Config, args: ProcessArgs, supervisor: int | None) -> int:
    from dppo.machine import usable_cores
    from dppo.wire.socket_links import Alarm, SocketLearnerLink
    from dppo.wire.zenoh_links import ZenohLearnerLink
    from learner.arguments import listening_address
    from learner.ending import run
    from learner.local import LocalWorkers
    from learner.logfile import log_to_file
    from learner.replay import Original
    from learner.session import Session
    from learner.signals import StopSignals

    original = Original.read(Path(args.replay), config) if args.replay else None
    stop_at = args.stop_at or sys.maxsize
    if original is not None:
        stop_at = min(stop_at, len(original.iterations) * config.rollout.samples)
    address = listening_address(args.listen, args.insecure)
    alarm = Alarm()
    link = SocketLearnerLink(ZenohLearnerLink(address, alarm.ring), alarm)
    signals = StopSignals(supervisor)
    folder = _folder(config, args, original)
    log_file = log_to_file(folder.path / "log.txt")
    count = args.local_workers
    if count < 0:
        count = min(usable_cores(), config.rollout.slots)
    most_silent = _SETUP_SECONDS + 10 * args.patience
    workers = LocalWorkers(link, count, args.verbose, most_silent)

    def look_after() -> None:
        signals.check()
        workers.look_after()

    every, keep = args.checkpoint_every, args.keep_checkpoints
    session = Session(config, folder, link, look_after, every, keep, args.patience, original)
    _announce(config, folder.path, address, count)
    try:
        workers.start()
        code = run(session, signals, folder, stop_at)
        return code if original is None else _compared(session, original)
    finally:
        workers.end()
        link.close()
        log_file.settle()
        folder.discard_unused()


def _compared(session: "Session", original: "Original") -> int:
    """A replay is over, and nothing that it has reached differs."""
    done = 0 if session.state is None else session.state.iteration
    if done < len(original.iterations):
        say(
            f"stopped after {done} of {len(original.iterations)} iterations: not compared to the "
            "end; the same command goes on"
        )
        return 1
    say(original.verdict)
    return 0


def _folder(config: Config, args: ProcessArgs, original: "Original | None") -> "RunDirectory":
    """The run directory, if this run may begin or go on in it.

    Raises:
        UsageError: it may not; says why.
    """
    from dppo.errors import UsageError
    from dppo.store.run_directory import RunDirectory, default_path

    path = Path(args.run_dir) if args.run_dir else default_path(config, args.name)
    folder = RunDirectory.open(path)
    if folder.has_run and args.resume == "never":
        raise UsageError(
            f"--run-dir {path} holds a run and --resume is never; give another folder, or "
            "--resume auto to continue it"
        )
    folder.check_config(config)
    if original is not None:
        original.check_folder(folder)
    folder.check_fence()
    return folder


def _announce(config: Config, path: Path, address: str, count: int) -> None:
    """The first lines: what runs where, and what psi means in it."""
    if address.startswith(("tcp/0.0.0.0:", "tcp/[::]:")):
        address = f"tcp/{socket.gethostname()}:{address.rpartition(':')[2]}"
    unit = "1" if config.safety.adv_norm == "separate" else "1/scaled reward"
    if unit != "1" and config.returns.delta_reward == "raw":
        unit = "scaled reward/raw reward²"
    say(
        f"training {config.run.env}: {config.iterations} iterations of "
        f"{config.rollout.samples} steps in {config.rollout.slots} slots, "
        f"psi {config.safety.psi:g} (adv-norm {config.safety.adv_norm}, unit {unit}), "
        f"seed {config.run.seed}\n"
        f"run directory {path}; {count} local workers; others: dppo-worker --connect {address}"
    )
    if not config.rollout.exact_envs:
        say("--no-exact-envs: after a loss or a resume this run is no longer exact")
    if config.iterations == 1:
        say("one iteration only fills the shared statistics: nothing will be learned")


if __name__ == "__main__":
    main()
