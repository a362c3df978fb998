"""Small files that are whole, the old one or the new one, whatever stops the writing; locks."""

import contextlib
import fcntl
import os
from pathlib import Path


def safe_name(env_id: str) -> str:
    """A Gymnasium id as part of a file's name."""
    return env_id.replace("/", "-").replace(":", "-")


def write_durably(path: Path, data: bytes) -> None:
    """Write a file and flush it to the disk; what is left after a failure is torn."""
    handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC, 0o644)
    try:
        done = 0
        with memoryview(data) as rest:
            while done < len(rest):
                done += os.write(handle, rest[done:])
        os.fsync(handle)
    finally:
        os.close(handle)


def flush_folder(folder: Path) -> None:
    """Flush a folder's entries to the disk."""
    handle = os.open(folder, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def replace_durably(path: Path, data: bytes) -> None:
    """Replace a file, all or nothing.

    Raises:
        OSError: the disk is full, read-only or gone; the file is what it was.
    """
    draft = path.with_name(f".{path.name}.draft")
    try:
        write_durably(draft, data)
        draft.rename(path)
    except OSError:
        with contextlib.suppress(OSError):  # it may be what fills the disk
            draft.unlink()
        raise
    flush_folder(path.parent)


def take_lock(path: Path) -> int | None:
    """Lock a file for this process, however it ends; None: another one has the lock.

    Raises:
        OSError: the file cannot be made, or its file system keeps no locks.
    """
    handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(handle)
        return None
    except OSError:
        os.close(handle)
        raise
    return handle
