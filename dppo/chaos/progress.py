"""How far a run is, read from its metrics.jsonl; a learner that starts anew cuts the file back."""

import itertools
import json
import statistics
from pathlib import Path

_TAIL = 16384
"""More than one line's bytes."""


class Progress:
    """The newest iteration that a run has logged, and the highest one ever."""

    def __init__(self, run_dir: Path, now: float) -> None:
        self._file = run_dir / "metrics.jsonl"
        self.highest = 0
        self.since = now
        """When `highest` came."""

    def look(self, now: float) -> int:
        """The highest iteration that was ever logged."""
        newest = self._newest()
        if newest > self.highest:
            self.highest, self.since = newest, now
        return self.highest

    def _newest(self) -> int:
        try:
            with self._file.open("rb") as file:
                file.seek(max(0, self._file.stat().st_size - _TAIL))
                whole = file.read().split(b"\n")[:-1]  # what follows the last newline is torn
        except OSError:
            return 0
        return int(json.loads(whole[-1])["iteration"]) if whole else 0


def median_seconds(run_dir: Path) -> float:
    """What one iteration of a run took, in the middle; faults are outliers."""
    file = run_dir / "metrics.jsonl"
    times = [json.loads(line)["time"] for line in file.read_text().splitlines()]
    gaps = [after - before for before, after in itertools.pairwise(times)]
    return statistics.median(gaps) if gaps else 0.0
