"""One learner at work: from a configuration to the contents of result.json."""

import json
import logging
import time
from collections.abc import Callable
from functools import partial
from typing import Any

from dppo.config import Config
from dppo.deadlines import Deadlines
from dppo.leases import Leases
from dppo.networks import Networks
from dppo.sources import made_by
from dppo.statistics import cvar
from dppo.store.checkpoint import Checkpoint, newest_checkpoint, sha256
from dppo.store.contents import SNAPSHOT_FORM, check_snapshots, was_exact
from dppo.store.ledger import Line
from dppo.store.run_directory import RunDirectory
from dppo.wire.links import LearnerLink
from dppo.wire.messages import Welcome
from learner.chief import Chief
from learner.console import Console
from learner.disk import Disk
from learner.dropping import Accounts
from learner.exchange import Exchange
from learner.facts import check_environment, run_facts, sizes
from learner.farewell import dismiss
from learner.ledger import Ledger
from learner.replay import Original
from learner.report import Finished
from learner.runlog import RunLog
from learner.saving import Saving
from learner.soundness import Expected
from learner.state import State

log = logging.getLogger("learner")
_STOP_SECONDS = 6.0


class Session:
    """A run on one link: trains, checkpoints, reports."""

    def __init__(
        self,
        config: Config,
        folder: RunDirectory,
        link: LearnerLink,
        look_after: Callable[[], None],
        checkpoint_every: int,
        keep: int,
        patience: float,
        original: Original | None = None,
    ) -> None:
        """With an `original` it is run again, by its ledger."""
        self._config, self._folder, self._original = config, folder, original
        self._link, self._look_after = link, look_after
        self._every = checkpoint_every
        self._made_by = made_by()
        self.generation = folder.next_generation()
        welcome = Welcome(
            run=folder.run_id(),
            generation=self.generation,
            config=json.dumps(config.to_dict()),
            name=folder.path.name,
        )
        self._run_id = welcome.run
        rollout = config.rollout
        self._deadlines = Deadlines(rollout.slots, 0 if original else rollout.drop_limit)
        self._exchange = Exchange(
            link,
            welcome,
            Leases(rollout.slots),
            look_after,
            patience,
            deadlines=self._deadlines,
        )
        self._exchange.roster.code = self._made_by["code"]
        self._disk = Disk(folder.path, "the run's logs")
        self._saving = Saving(self._disk, folder.checkpoints, keep, self._checkpoint_facts)
        self._is_saved = False
        self._ledger: Ledger | None = None
        self.state: State | None = None

    def train(self, stop_at: int) -> dict[str, object]:
        """Train to the end, or until `stop_at` environment steps; the contents of result.json."""
        checkpoint = newest_checkpoint(self._folder.checkpoints)
        if checkpoint is not None and checkpoint.facts["env_steps"] >= self._all_steps:
            return self._told_later(checkpoint)  # killed at the very end; the workers may be gone
        spaces = self._exchange.wait_for_environment()
        networks = Networks.build(spaces, self._config)
        self._exchange.expected = Expected(
            spaces, networks.size, self._config.rollout.samples_per_slot
        )
        if checkpoint is None:
            self.state = State.initial(networks, spaces.obs_size, self._config)
            if self._original is not None:
                check_environment(self._original.facts, self._facts, self._original.run)
            self._write_config(networks)
        else:
            before = self._folder.read_json("config.json")
            is_same = check_environment(before, self._facts, self._folder.path)
            check_snapshots(checkpoint)
            self.state = State.from_checkpoint(checkpoint)
            self._exchange.exact = was_exact(checkpoint) and is_same
            self._saving.resumed(self.state)
            log.warning(
                "resuming at iteration %d of %d", self.state.iteration, self._config.iterations
            )
        ledger, runlog = self._take_up_logs(self.state.iteration)
        console = Console(self._config, self._env_steps)
        try:
            self._iterate(networks, ledger, runlog, console, stop_at)
        finally:
            self._exchange.meanwhile.do()
            console.close()
            runlog.close()
        finished = self.state.iteration >= self._config.iterations
        self._exchange.stop("the run is finished" if finished else "the learner pauses", finished)
        return self._result("finished" if finished else "stopped")

    def _take_up_logs(self, iteration: int) -> tuple[Ledger, RunLog]:
        """The run's files, where the state stands."""
        rollout = self._config.rollout
        accounts = Accounts(rollout.slots)

        def noted(line: Line) -> None:
            accounts.note(line)
            if self._original is not None:  # it may have changed since
                self._original.compare(line)

        runlog = RunLog(self._folder.path, iteration, self._disk, noted)
        self._deadlines.resume(accounts.running)
        self._ledger = Ledger(rollout, runlog.note, self._deadlines, accounts, self._original)
        return self._ledger, runlog

    def _told_later(self, checkpoint: Checkpoint) -> dict[str, object]:
        """The contents of result.json of a run that an earlier learner has brought to its end."""
        self.state = State.from_checkpoint(checkpoint)
        self._exchange.exact = was_exact(checkpoint)
        _, runlog = self._take_up_logs(self.state.iteration)
        runlog.close()
        if not self._folder.is_finished:  # nor may its workers know
            dismiss(self._link, "the run is finished")
        return self._result("finished")

    def save(self) -> None:
        """Make sure, for a run that stops, that the newest whole iteration is on the disk.

        Raises:
            RunFailedError: it cannot be written, or not within the time that a stop may take.
        """
        if self.state is not None and not self._is_saved:
            self._is_saved = True  # or will not be: a disk that hangs is not waited for twice
            self._saving.finish(self.state, most=_STOP_SECONDS)

    def interrupted(self) -> dict[str, object] | None:
        """After a signal: pause the workers; the contents of result.json, if anything was done."""
        self._exchange.stop("the learner was stopped", final=False)
        return None if self._ledger is None else self._result("stopped")

    def _iterate(
        self, networks: Networks, ledger: Ledger, runlog: RunLog, console: Console, stop_at: int
    ) -> None:
        assert self.state is not None
        chief = Chief(self.state, networks, self._config, self.generation, self._exchange, ledger)
        while self.state.iteration < self._config.iterations and self._env_steps < stop_at:
            begun = time.monotonic()
            finished = chief.iterate()
            tell = partial(self._tell, finished, time.monotonic() - begun, ledger, runlog, console)
            self._exchange.meanwhile.add(tell)
            self.state = chief.state
            if self.state.iteration % self._every == 0:
                self._exchange.meanwhile.do()  # lines are on the disk before their checkpoint is
                self._saving.begin(self.state)
        self._exchange.meanwhile.do()
        self._saving.finish(self.state, look_after=self._look_after)

    def _tell(
        self,
        finished: Finished,
        seconds: float,
        ledger: Ledger,
        runlog: RunLog,
        console: Console,
    ) -> None:
        """One iteration, which took so long, to files and screen."""
        ledger.iterated(finished.before.iteration, finished.after.parameters, finished.collected)
        report = finished.report()
        speed = self._config.rollout.samples / seconds
        measured = {
            "charts/SPS": speed,
            "cluster/round_ms": 1000 * seconds / (self._config.update.updates + 2),
            "cluster/unsaved_iterations": self._saving.unsaved(report.iteration),
        }
        runlog.write(report, measured | ledger.accounts.metrics())
        console.show(report, speed)

    @property
    def _facts(self) -> dict[str, Any]:
        return run_facts(self._exchange.roster, self._made_by["code"])

    @property
    def _is_exact(self) -> bool:
        """The bits are those of an undisturbed run, as far as that can be known."""
        return self._exchange.exact and self._exchange.roster.exact

    @property
    def _all_steps(self) -> int:
        """Environment steps of the whole run."""
        return self._config.env_steps(self._config.iterations)

    @property
    def _env_steps(self) -> int:
        """Environment steps of the run so far."""
        return 0 if self.state is None else self._config.env_steps(self.state.iteration)

    def _checkpoint_facts(self, state: State) -> dict[str, Any]:
        """What a checkpoint holds besides the state.

        Raises:
            SupersededError: another learner has taken over the folder.
        """
        self._folder.check_generation(self.generation)
        return {
            "config": self._config.to_dict(),
            "env_steps": self._config.env_steps(state.iteration),
            "parameters_sha256": sha256(state.parameters),
            "spaces": sizes(self._exchange.roster),
            "snapshots": SNAPSHOT_FORM,
            "run": self._run_id,
            "generation": self.generation,
            "made_by": self._made_by,
            "exact": self._is_exact,
        }

    def _write_config(self, networks: Networks) -> None:
        original = self._original
        self._folder.write_json(
            "config.json",
            {
                "config": self._config.to_dict(),
                **({} if original is None else {"replay_of": original.run_id}),
                **self._facts,
                "parameters": networks.size,
                "iterations": self._config.iterations,
            },
        )

    def _result(self, status: str) -> dict[str, object]:
        assert self.state is not None
        assert self._ledger is not None
        state, returns = self.state, self.state.episodes[:, 0]
        some = len(returns) > 0
        return {
            "status": status,
            "env": self._config.run.env,
            "seed": self._config.run.seed,
            "iterations": state.iteration,
            "env_steps": self._env_steps,
            "episode_return_mean": state.mean_return if some else None,
            "episode_return_std": float(returns.std()) if some else None,
            "episode_return_cvar10": cvar(returns) if some else None,
            "parameters_sha256": sha256(state.parameters),
            "episodes": state.finished_episodes,
            "restarts": self.generation - 1,
            "exact": self._config.rollout.drop == 0 and self._is_exact,
            "dropped_gradients": state.dropped_gradients,
            **self._ledger.accounts.figures(),
        }
