"""`dppo four-rooms`: runs the experiment and writes its results, figures and report."""

import json
import time
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from dppo.config import require_seed
from dppo.errors import UsageError
from dppo.files import replace_durably
from dppo.four_rooms.agent import Outcome, Progress
from dppo.four_rooms.console import Console
from dppo.four_rooms.experiment import (
    Arm,
    ArmOutcome,
    Collector,
    ablations,
    psi_sweep,
    table_1,
    trials_of,
)
from dppo.four_rooms.processes import learn_on_cores
from dppo.four_rooms.settings import AgentConfig
from dppo.four_rooms.world import World, WorldConfig
from dppo.machine import usable_cores
from dppo.process import Terminated
from dppo.settings import require


@dataclass(frozen=True, kw_only=True)
class FourRoomsArgs:
    """Safe actor-critic on Four Rooms: Table 1 and figures 1 to 5 of the paper, in one folder."""

    trials: int = 50
    """Trials of each arm [count]."""
    episodes: int = 4000
    """Episodes of each trial [count]."""
    seed: int = 0
    """Of every random stream; trial k of a seed gives the same numbers whatever runs beside it."""
    psi_sweep: bool = False
    """Run the safe arm also with ψ = 0, 0.015, 0.05, 0.1 and 0.25."""
    ablations: bool = False
    """Run also: Algorithm 1 as printed, equal α_c, and four more variants of both arms."""
    jobs: int = 0
    """Processes; 0: one per core this process may use [count]."""
    out: str = "runs/four-rooms"
    """Folder for results.json, report.md and the figures; older ones in it are replaced."""
    plain_alpha_critic: float = 0.1
    """α_c of the plain arm, ψ = 0, which Table 1 gives another one than the safe arm."""
    agent: AgentConfig = field(default_factory=AgentConfig)
    """The safe arm."""
    world: WorldConfig = field(default_factory=WorldConfig)
    """The variant of the world."""

    def __post_init__(self) -> None:
        """Refuse what cannot be run."""
        for name in ("trials", "episodes"):
            require(getattr(self, name) >= 1, name, getattr(self, name), ">= 1")
        require(self.jobs >= 0, "jobs", self.jobs, ">= 0")
        require_seed(self.seed)
        alpha = self.plain_alpha_critic
        require(0 < alpha <= 1, "plain_alpha_critic", alpha, "0 < rate <= 1")

    @property
    def arms(self) -> list[Arm]:
        """What is compared."""
        return [
            *table_1(self.agent, self.plain_alpha_critic),
            *(psi_sweep(self.agent) if self.psi_sweep else ()),
            *(ablations(self.agent, self.plain_alpha_critic) if self.ablations else ()),
        ]


def run(args: FourRoomsArgs) -> int:
    """Run the arms; write what has finished; the exit code.

    Raises:
        UsageError: the folder cannot be written.
        KeyboardInterrupt, Terminated: the user stopped it; the arms that finished are kept.
    """
    folder = _writable(Path(args.out))
    begun = time.monotonic()
    outcomes, stop = _learn(args)
    seconds = {"learning": time.monotonic() - begun}
    if stop is not None and not outcomes:
        print("stopped before an arm had finished all its trials; nothing was written")
        raise stop
    results = _write(folder, args, outcomes, stopped=stop is not None, seconds=seconds)
    if stop is not None:
        print(f"stopped: {len(outcomes)} of {len(args.arms)} arms had finished and are kept")
    for arm in results["arms"]:
        print(
            f"{arm['key']:28} return {arm['return_mean']:6.2f} ± "
            f"{arm['return_std_across_trials']:5.2f}   frozen steps "
            f"{arm['frozen_steps_per_episode']:6.2f}   time-outs {arm['timeouts_fraction']:6.1%}"
        )
    print(f"{sum(results['seconds'].values()):.0f} s; see {folder / 'report.md'}")
    if stop is not None:
        raise stop
    return 0


def _writable(folder: Path) -> Path:
    """The folder, made if need be.

    Raises:
        UsageError: it cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe = folder / ".probe"
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise UsageError(
            f"--out {folder} cannot be written: {error.strerror}; give a folder of yours"
        ) from error
    return folder


def _learn(args: FourRoomsArgs) -> tuple[list[ArmOutcome], BaseException | None]:
    """The arms that finished, and the user's signal if it came before the others did."""
    collector = Collector(args.arms, args.trials)
    trials = trials_of(args.arms, args.trials)
    events = learn_on_cores(
        args.world,
        trials,
        episodes=args.episodes,
        seed=args.seed,
        jobs=args.jobs or usable_cores(),
    )
    try:
        with closing(events), Console(len(trials) * args.episodes) as console:
            for event in events:
                match event:
                    case Progress():
                        console.advance(event.episodes)
                    case Outcome():
                        for arm in collector.add(event):
                            console.say(f"{arm.key} has finished")
    except (KeyboardInterrupt, Terminated) as stop:
        return collector.finished(), stop
    return collector.finished(), None


def _write(
    folder: Path,
    args: FourRoomsArgs,
    outcomes: list[ArmOutcome],
    *,
    stopped: bool,
    seconds: dict[str, float],
) -> dict[str, Any]:
    """results.json, the figures and report.md; the results."""
    from dppo.four_rooms.pictures import save_pictures
    from dppo.four_rooms.report import report
    from dppo.four_rooms.results import describe, measure

    begun = time.monotonic()
    findings = measure(World(args.world), outcomes, seed=args.seed)
    results = describe(findings)
    names = save_pictures(folder, findings, results)
    results["status"] = "stopped" if stopped else "finished"
    results["jobs"] = args.jobs or usable_cores()
    results["seconds"] = seconds | {"measuring and drawing": time.monotonic() - begun}
    replace_durably(folder / "results.json", (json.dumps(results) + "\n").encode())
    replace_durably(folder / "report.md", report(results, names).encode())
    return results
