"""The folder of a run: who may use it, what run it belongs to, where things are.

config.json       resolved settings, versions, hash of the model XML
progress.csv      one row per iteration        metrics.jsonl   the same, one object per line
checkpoints/      see checkpoint.py            ledger.jsonl    see ledger.py
log.txt           what the learner logged      result.json     how it ended
generation        how often a learner was started here
"""

import fcntl
import json
import os
import shutil
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from dppo.config import Config
from dppo.errors import UsageError
from dppo.store.checkpoint import flush_folder, names, write_durably


def default_path(config: Config, name: str) -> Path:
    """runs/<env>__<name>__psi<psi>__s<seed>__<UTC time>."""
    env = config.run.env.replace("/", "-").replace(":", "-")
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
            lock = os.open(path / ".lock", os.O_RDWR | os.O_CREAT, 0o644)
        except OSError as error:
            raise UsageError(
                f"--run-dir {path} cannot be written: {error.strerror}; give a folder of yours"
            ) from error
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            os.close(lock)
            raise UsageError(
                f"another learner is at work in --run-dir {path}; stop it, or give another folder"
            ) from error
        return cls(path, is_new, lock)

    @property
    def checkpoints(self) -> Path:
        """Where the checkpoints are."""
        return self.path / "checkpoints"

    @property
    def has_run(self) -> bool:
        """A run has left a checkpoint here."""
        return bool(names(self.checkpoints))

    def discard_unused(self) -> None:
        """Remove a folder that was made for a run that never began."""
        if self.is_new and not (self.path / "config.json").exists():
            shutil.rmtree(self.path, ignore_errors=True)

    def next_generation(self) -> int:
        """Count one more start; survives a crash right after."""
        file = self.path / "generation"
        try:
            generation = int(file.read_text()) + 1
        except (OSError, ValueError):
            generation = 1
        self.write("generation", str(generation))
        return generation

    def check_config(self, config: Config) -> None:
        """Refuse to continue a run with other settings.

        Raises:
            UsageError: config.json is not one, or differs; every difference is listed.
        """
        file = self.path / "config.json"
        if not file.exists():
            return
        before = read_config(file).to_dict()
        now = config.to_dict()
        differences = [
            f"--{name.replace('_', '-')} was {before[group][name]}, is {value}"
            for group, fields in now.items()
            for name, value in fields.items()
            if before[group][name] != value
        ]
        if differences:
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
        draft = self.path / f".{name}.draft"
        write_durably(draft, text.encode())
        draft.rename(self.path / name)
        flush_folder(self.path)

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
