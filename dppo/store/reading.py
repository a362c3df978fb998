"""What a run has left so far, read from outside, while a learner may be writing it."""

import json
import os
from pathlib import Path
from typing import Any

_TAIL = 65536
"""More than one line's bytes."""


def read_object(file: Path) -> dict[str, Any]:
    """A JSON object; empty: there is none, or not a whole one."""
    try:
        return _object(file.read_bytes())
    except OSError:
        return {}


def newest_row(run_dir: Path) -> dict[str, Any]:
    """The last whole line of a run's metrics.jsonl; empty: none yet."""
    try:
        with (run_dir / "metrics.jsonl").open("rb") as lines:
            lines.seek(max(0, os.fstat(lines.fileno()).st_size - _TAIL))
            whole = lines.read().split(b"\n")[:-1]  # what follows the last newline is torn
    except OSError:
        return {}
    return _object(whole[-1]) if whole else {}


def _object(text: bytes) -> dict[str, Any]:
    try:
        values = json.loads(text)
    except ValueError:
        return {}
    return values if isinstance(values, dict) else {}
