"""Which code a run was made with."""

import hashlib
from importlib import metadata
from pathlib import Path

_PACKAGES = ("dppo", "learner", "workers")
_ROOT = Path(__file__).parent.parent


def code_hash(root: Path = _ROOT) -> str:
    """Of all our Python files, names and contents: 12 hexadecimal digits.

    A version number names a release; between two releases only this tells runs apart.
    """
    found = hashlib.sha256()
    for file in sorted(file for name in _PACKAGES for file in (root / name).rglob("*.py")):
        found.update(f"{file.relative_to(root).as_posix()}\n".encode())
        found.update(hashlib.sha256(file.read_bytes()).digest())
    return found.hexdigest()[:12]


def version() -> str:
    """Of the installed package; empty where only the source lies."""
    try:
        return metadata.version("dppo")
    except metadata.PackageNotFoundError:
        return ""
