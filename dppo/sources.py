"""Which code is at work, and which a run was made with."""

import hashlib
from importlib.metadata import version
from pathlib import Path

_PACKAGES = ("dppo", "learner", "workers")
_LIBRARIES = ("dppo", "numpy", "mujoco", "gymnasium", "eclipse-zenoh")
"""What decides the bits of a run, or whether two processes understand each other."""
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


def versions() -> dict[str, str]:
    """Of this package and of the libraries that count, by name."""
    return {name: version(name) for name in _LIBRARIES}


def made_by() -> dict[str, str]:
    """Release and code of this package, to stand in what it writes."""
    return {"dppo": version("dppo"), "code": code_hash()}


def version_line() -> str:
    """What --version prints: equal lines, equal software."""
    found = versions()
    own = found.pop("dppo")
    libraries = (f"{name} {number}" for name, number in found.items())
    return f"dppo {own} ({', '.join([f'code {code_hash()}', *libraries])})"
