"""How far a run is, read from its metrics.jsonl; a learner that starts anew cuts the file back."""

import itertools
import json
import statistics
from pathlib import Path

from dppo.store.reading import newest_row


class Progress:
    """The newest iteration that a run has logged, and the highest one ever."""

    def __init__(self, run_dir: Path, now: float) -> None:
        self._run_dir = run_dir
        self.highest = 0
        self.since = now
        """When `highest` came."""

    def look(self, now: float) -> int:
        """The highest iteration that was ever logged."""
        newest = int(newest_row(self._run_dir).get("iteration", 0))
        if newest > self.highest:
            self.highest, self.since = newest, now
        return self.highest


def median_seconds(run_dir: Path) -> float:
    """What one iteration of a run took, in the middle; faults are outliers."""
    file = run_dir / "metrics.jsonl"
    times = [json.loads(line)["time"] for line in file.read_text().splitlines()]
    gaps = [after - before for before, after in itertools.pairwise(times)]
    return statistics.median(gaps) if gaps else 0.0
