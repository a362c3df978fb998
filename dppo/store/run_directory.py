"""The folder of a run: who may use it, what run it belongs to, where things are.

config.json       resolved settings, versions, hash of the model XML
progress.csv      one row per iteration        metrics.jsonl   the same, one object per line
checkpoints/      see checkpoint.py            ledger.jsonl    see ledger.py
episodes.jsonl    returns and lengths of the episodes that ended in each iteration
log.txt           what the learner logged      result.json     how it ended
generation        how often a learner was started here
run-id            the run's random id, the same in every copy of the folder
superseded        why no learner goes on here: the run has gone on elsewhere
"""

import json
import re
import secrets
import shutil
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from dppo.config import Config
from dppo.errors import SupersededError, UsageError
from dppo.files import replace_durably, safe_name, take_lock
from dppo.store.checkpoint import names

_RUN_ID = re.compile("[0-9a-f]{16}")


def default_path(config: Config, name: str) -> Path:
    """runs/<env>__<name>__psi<psi>__s<seed>__<UTC time>."""
    env = safe_name(config.run.env)
    now = datetime.now(UTC).strftime("%Y%m%dT%H%M%S%f")[:-3]
    return Path("runs") / f"{env}__{name}__psi{config.safety.psi:g}__s{config.run.seed}__{now}"


@dataclass(frozen=True, slots=True)
class RunDirectory:
    """A run's folder, locked for one learner."""

    path: Path
    is_new: bool
    """The folder was made for this run."""
    _lock: int
    """File descriptor; the lock goes with the process, however it ends."""

    @classmethod
    def open(cls, path: Path) -> "RunDirectory":
        """Make the folder if need be, and take its lock.

        Raises:
            UsageError: it cannot be written, or another learner is at work in it.
        """
        try:
            is_new = not path.exists()
            (path / "checkpoints").mkdir(parents=True, exist_ok=True)
            lock = take_lock(path / ".lock")
        except OSError as error:
            raise UsageError(
                f"--run-dir {path} cannot be written: {error.strerror}; give a folder of yours"
            ) from error
        if lock is None:
            raise UsageError(
                f"another learner is at work in --run-dir {path}; stop it, or give another folder"
            )
        return cls(path, is_new, lock)

    @property
    def checkpoints(self) -> Path:
        """Where the checkpoints are."""
        return self.path / "checkpoints"

    @property
    def has_run(self) -> bool:
        """A run has left a checkpoint here."""
        return bool(names(self.checkpoints))

    @property
    def is_finished(self) -> bool:
        """An earlier learner has brought the run to its end, and said so."""
        there = (self.path / "result.json").exists()
        return there and self.read_json("result.json").get("status") == "finished"

    def discard_unused(self) -> None:
        """Remove a folder that was made for a run that never began."""
        if self.is_new and not (self.path / "config.json").exists():
            shutil.rmtree(self.path, ignore_errors=True)

    def next_generation(self) -> int:
        """Count one more start; survives a crash right after, and a damaged count.

        Raises:
            UsageError: the count cannot be written, so a run cannot begin here.
        """
        saved = [generation for _, generation in self._saved_facts()]
        generation = max([self._counted(), *saved]) + 1
        try:
            self.write("generation", str(generation))
        except OSError as error:
            raise UsageError(
                f"{self.path / 'generation'} cannot be written: {error.strerror}; make room, or "
                "see to the disk, and start the same command again"
            ) from error
        return generation

    def check_generation(self, generation: int) -> None:
        """Refuse to write for a learner after which another one was started here.

        The lock should not let that happen; some network file systems know no locks.

        Raises:
            SupersededError: the count has gone on.
        """
        newest = self._counted()
        if newest > generation:
            raise SupersededError(
                f"another learner, generation {newest}, was started in {self.path} after this "
                f"one, generation {generation}; its file system keeps no locks: see that only "
                "one learner runs there",
                newest,
            )

    def run_id(self) -> str:
        """The run's random id: made once, kept by every resume and every copy."""
        file = self.path / "run-id"
        try:
            written = file.read_text()
        except (OSError, ValueError):
            written = ""
        known = [written, *(run for run, _ in self._saved_facts())]
        run = next((run for run in known if _RUN_ID.fullmatch(run)), None) or secrets.token_hex(8)
        if run != written:
            self.write(file.name, run)
        return run

    def fence_off(self, reason: SupersededError) -> SupersededError:
        """Let no later start go on from this old copy by itself; what to tell the user.

        A start that is repeated again and again would else count up until no worker objects. The
        newer learner may also be at work in this very folder, as its count then shows: nothing is
        written.
        """
        if self._counted() >= reason.newest:
            return reason
        file = self.path / "superseded"
        sentence = f"{reason}; or, to go on from this one all the same, delete {file}"
        try:
            self.write(file.name, sentence + "\n")
            self.write("generation", str(reason.newest))  # whoever deletes it gets the next one
        except OSError:
            return reason  # no room for a note: what matters more is why this learner stops
        return SupersededError(sentence, reason.newest)

    def check_fence(self) -> None:
        """Refuse a folder whose run has gone on elsewhere.

        Raises:
            SupersededError: an earlier learner here has found that out; says how.
        """
        file = self.path / "superseded"
        if file.exists():
            raise SupersededError(f"an earlier start here found: {file.read_text().strip()}")

    def _counted(self) -> int:
        """The newest generation, as the folder's count has it; 0: none, or not readable."""
        try:
            return int((self.path / "generation").read_text())
        except (OSError, ValueError):
            return 0

    def _saved_facts(self) -> list[tuple[str, int]]:
        """Run and generation, as far as checkpoints have them, damaged ones included."""
        found = []
        for manifest in self.checkpoints.glob("*iteration-*/manifest.json"):
            try:
                facts = json.loads(manifest.read_bytes())["facts"]
                found.append((str(facts["run"]), int(facts["generation"])))
            except (OSError, ValueError, KeyError, TypeError):
                continue  # torn, or of an earlier version
        return found

    def check_config(self, config: Config) -> None:
        """Refuse to continue a run with other settings.

        Raises:
            UsageError: config.json is not one, or differs; every difference is listed.
        """
        file = self.path / "config.json"
        if not file.exists():
            return
        if differences := config.differences(read_config(file)):
            raise UsageError(
                f"{self.path} holds a run with other settings: {'; '.join(differences)}; use the "
                "same settings to continue it, or another --run-dir"
            )

    def read_json(self, name: str) -> dict[str, Any]:
        """A JSON file of this folder."""
        values: dict[str, Any] = json.loads((self.path / name).read_text())
        return values

    def write(self, name: str, text: str) -> None:
        """Replace a small file, all or nothing."""
        replace_durably(self.path / name, text.encode())

    def write_json(self, name: str, values: dict[str, Any]) -> None:
        """Replace a JSON file, all or nothing."""
        self.write(name, json.dumps(values, indent=2) + "\n")


def read_config(path: Path) -> Config:
    """The settings in a run's config.json, or in a JSON or TOML file of the same form.

    Raises:
        UsageError: the file cannot be read, or is no such file; says what was found.
    """
    import tomllib

    try:
        text = path.read_text()
        values = tomllib.loads(text) if path.suffix == ".toml" else json.loads(text)
    except (OSError, ValueError) as error:
        raise UsageError(
            f"{path} is not a readable config file (JSON or TOML): {error}"
        ) from error
    try:
        if isinstance(values, dict):
            values = values.get("config", values)
        if not isinstance(values, dict):
            raise ValueError(f"found a {type(values).__name__}, expected tables such as [run]")
        return Config.from_dict(values)
    except ValueError as error:
        raise UsageError(f"{path} is not a config file: {error}") from error
