"""Checkpoints: arrays in safetensors, facts in JSON; atomic, checksummed, never executable.

    checkpoints/
        iteration-00000040/
            arrays.safetensors
            manifest.json        facts, and SHA-256 of the arrays and of itself
        best.json                name of the checkpoint with the highest mean return

A checkpoint is written into a hidden folder, flushed to the disk, and renamed. Before it is
deleted it gets a hidden name again. So a folder with a checkpoint's name is whole, unless the disk
lies, and then its checksum says so.
"""

import contextlib
import hashlib
import json
import logging
import os
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors.numpy import load, save

from dppo.errors import CheckpointError
from dppo.files import flush_folder, replace_durably, write_durably

FORMAT = 1
Arrays = dict[str, NDArray[Any]]
log = logging.getLogger("checkpoint")


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """What was saved."""

    arrays: Arrays
    facts: dict[str, Any]
    """Plain JSON values."""


def sha256(array: NDArray[Any]) -> str:
    """Hash of an array's bytes, little-endian."""
    return hashlib.sha256(np.ascontiguousarray(array).tobytes()).hexdigest()


def _seal(manifest: dict[str, Any]) -> str:
    """Hash of a manifest without its own hash."""
    rest = {name: value for name, value in manifest.items() if name != "sha256"}
    return hashlib.sha256(json.dumps(rest, sort_keys=True).encode()).hexdigest()


def name_of(iteration: int) -> str:
    """Folder name of the checkpoint at the start of an iteration."""
    return f"iteration-{iteration:08d}"


def save_checkpoint(folder: Path, name: str, checkpoint: Checkpoint) -> Path:
    """Write a checkpoint as `folder`/`name`, all or nothing.

    One of that name that verifies stays as it is: it is of the same iteration of the same run.

    Raises:
        OSError: the disk is full, read-only or gone; the folder's whole checkpoints are untouched.
    """
    folder.mkdir(parents=True, exist_ok=True)
    draft, final = folder / f".{name}.{os.getpid()}", folder / name
    _sweep(folder)
    if _verifies(final):
        flush_folder(folder)
        return final
    raw = save({name: np.ascontiguousarray(array) for name, array in checkpoint.arrays.items()})
    manifest = {
        "format": FORMAT,
        "arrays_sha256": hashlib.sha256(raw).hexdigest(),
        "facts": checkpoint.facts,
    }
    manifest["sha256"] = _seal(manifest)
    try:
        draft.mkdir(exist_ok=True)
        write_durably(draft / "arrays.safetensors", raw)
        write_durably(draft / "manifest.json", json.dumps(manifest, indent=1).encode())
        flush_folder(draft)
        if final.exists():
            _set_aside(final)
        draft.rename(final)
        flush_folder(folder)
    finally:
        shutil.rmtree(draft, ignore_errors=True)
    return final


def _verifies(path: Path) -> bool:
    try:
        load_checkpoint(path)
    except CheckpointError:
        return False
    return True


def _set_aside(path: Path) -> None:
    """Rename a corrupt checkpoint: it must not count as one; an earlier one of that name goes."""
    aside = path.with_name(f"corrupt-{path.name}")
    shutil.rmtree(aside, ignore_errors=True)
    path.rename(aside)


def load_checkpoint(path: Path | str) -> Checkpoint:
    """Read and verify one checkpoint folder.

    Raises:
        CheckpointError: missing, torn, altered, or of another format; says which file and why.
    """
    path = Path(path)
    try:
        manifest = json.loads((path / "manifest.json").read_bytes())
        raw = (path / "arrays.safetensors").read_bytes()
    except (OSError, ValueError) as error:
        raise CheckpointError(f"checkpoint {path} cannot be read: {error}") from error
    if not isinstance(manifest, dict) or manifest.get("sha256") != _seal(manifest):
        raise CheckpointError(f"{path / 'manifest.json'} does not match its own checksum")
    if manifest["format"] != FORMAT:
        raise CheckpointError(
            f"checkpoint {path} has format {manifest['format']}, this version reads {FORMAT}"
        )
    if hashlib.sha256(raw).hexdigest() != manifest["arrays_sha256"]:
        raise CheckpointError(f"{path / 'arrays.safetensors'} does not match its checksum")
    return Checkpoint(load(raw), manifest["facts"])


def names(folder: Path) -> list[str]:
    """Checkpoints in a folder, oldest first."""
    return sorted(path.name for path in folder.glob("iteration-*") if path.is_dir())


def newest_checkpoint(folder: Path) -> Checkpoint | None:
    """The newest checkpoint that verifies; None if there are none at all.

    A corrupt one is reported and passed over.

    Raises:
        CheckpointError: there are checkpoints, and every one is corrupt.
    """
    found = names(folder)
    for name in reversed(found):
        try:
            return _load_patiently(folder / name)
        except CheckpointError as error:
            log.warning("%s; falling back to the checkpoint before it", error)
            with contextlib.suppress(OSError):  # on a read-only disk it is passed over each time
                _set_aside(folder / name)
    if found:
        raise CheckpointError(
            f"every checkpoint in {folder} is corrupt ({', '.join(found)}); restore one from a "
            "backup, or start anew in another --run-dir"
        )
    return None


def _load_patiently(path: Path) -> Checkpoint:
    """Read once more what could not be read: a disk's error may pass."""
    try:
        return load_checkpoint(path)
    except CheckpointError as error:
        if not isinstance(error.__cause__, OSError):
            raise
    return load_checkpoint(path)


def mark_best(folder: Path, name: str, score: float) -> None:
    """Note which checkpoint has the highest mean return so far."""
    note = {"name": name, "episode_return_mean": score}
    replace_durably(folder / "best.json", json.dumps(note).encode())


def best_name(folder: Path) -> str | None:
    """The checkpoint that `mark_best` noted last, if it is still there."""
    try:
        name = str(json.loads((folder / "best.json").read_bytes())["name"])
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return name if name in names(folder) else None


def prune(folder: Path, keep: int) -> None:
    """Delete all but the newest `keep` checkpoints and the best."""
    best = best_name(folder)
    for name in names(folder)[: -max(keep, 1)]:
        if name != best:
            with contextlib.suppress(OSError):  # what stays is deleted the next time
                (folder / name).rename(folder / f".{name}.old")
    _sweep(folder)


def _sweep(folder: Path) -> None:
    """Make room: delete what a learner that was killed had begun to write or to delete."""
    for hidden in folder.glob(".iteration-*"):
        shutil.rmtree(hidden, ignore_errors=True)
