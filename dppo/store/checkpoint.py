"""Checkpoints: arrays in safetensors, facts in JSON; atomic, checksummed, never executable.

    checkpoints/
        iteration-00000040/
            arrays.safetensors
            manifest.json        facts, and SHA-256 of the arrays and of itself
        best.json                name of the checkpoint with the highest mean return

A checkpoint is written into a hidden folder, flushed to the disk, and renamed: a folder with a
checkpoint's name is whole, unless the disk lies, and then its checksum says so.
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

    Raises:
        OSError: the disk is full, read-only or gone; nothing of that name is left behind.
    """
    folder.mkdir(parents=True, exist_ok=True)
    draft, final = folder / f".{name}.{os.getpid()}", folder / name
    raw = save({name: np.ascontiguousarray(array) for name, array in checkpoint.arrays.items()})
    manifest = {
        "format": FORMAT,
        "arrays_sha256": hashlib.sha256(raw).hexdigest(),
        "facts": checkpoint.facts,
    }
    manifest["sha256"] = _seal(manifest)
    try:
        shutil.rmtree(draft, ignore_errors=True)
        draft.mkdir()
        write_durably(draft / "arrays.safetensors", raw)
        write_durably(draft / "manifest.json", json.dumps(manifest, indent=1).encode())
        shutil.rmtree(final, ignore_errors=True)  # a corrupt one of the same name
        draft.rename(final)
        flush_folder(folder)
    finally:
        shutil.rmtree(draft, ignore_errors=True)
    return final


def load_checkpoint(path: Path) -> Checkpoint:
    """Read and verify one checkpoint folder.

    Raises:
        CheckpointError: missing, torn, altered, or of another format; says which file and why.
    """
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
            return load_checkpoint(folder / name)
        except CheckpointError as error:
            log.warning("%s; falling back to the checkpoint before it", error)
            with contextlib.suppress(OSError):  # out of the way: it must not count as the newest
                (folder / name).rename(folder / f"corrupt-{name}")
    if found:
        raise CheckpointError(
            f"every checkpoint in {folder} is corrupt ({', '.join(found)}); restore one from a "
            "backup, or start anew in another --run-dir"
        )
    return None


def mark_best(folder: Path, name: str, score: float) -> None:
    """Note which checkpoint has the highest mean return so far."""
    draft = folder / ".best.json"
    write_durably(draft, json.dumps({"name": name, "episode_return_mean": score}).encode())
    draft.rename(folder / "best.json")


def best_name(folder: Path) -> str | None:
    """The checkpoint that `mark_best` noted last, if it is still there."""
    try:
        name = str(json.loads((folder / "best.json").read_bytes())["name"])
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return name if name in names(folder) else None


def prune(folder: Path, keep: int) -> None:
    """Delete all but the newest `keep` checkpoints and the best, and what was never finished."""
    for draft in folder.glob(".iteration-*"):  # of a learner that was killed while saving
        shutil.rmtree(draft, ignore_errors=True)
    best = best_name(folder)
    for name in names(folder)[: -max(keep, 1)]:
        if name != best:
            shutil.rmtree(folder / name, ignore_errors=True)


def write_durably(path: Path, data: bytes) -> None:
    """Write a file and flush it to the disk."""
    with path.open("wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())


def flush_folder(folder: Path) -> None:
    """Flush a folder's entries to the disk."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
