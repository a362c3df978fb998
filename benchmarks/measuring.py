"""What all benchmarks share: cases in processes of their own, interleaved repeats, cores, output.

A case is a process that sets up, says that it is ready, and then measures once per line on its
stdin. Processes, because what is measured changes process-wide things (MuJoCo's clock, threads),
and because peers may live in another virtual environment.
"""

import argparse
import contextlib
import json
import os
import statistics
import subprocess
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.processes import ONE_THREAD, SkippedError, started

Result = dict[str, Any]
_FORCED_BLAS = "OPENBLAS_CORETYPE", "OPENBLAS_L2_SIZE"


class Case:
    """One thing to measure, as a process that waits for a go."""

    def __init__(
        self,
        *words: str,
        python: str = sys.executable,
        core: int | None = None,
    ) -> None:
        """Start `python -m WORDS` with one thread, on one core if given.

        Raises:
            SkippedError: the process says that it cannot measure, or does not start.
        """
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
        self._tree = started([python, "-m", *words], ONE_THREAD, **pipes)
        self._process = self._tree.process
        if core is not None:
            os.sched_setaffinity(self._process.pid, {core})
        ready = self.finish()
        if "skipped" in ready:
            self.close()
            raise SkippedError(ready["skipped"])

    def go(self) -> None:
        """Let it measure once."""
        assert self._process.stdin is not None
        self._process.stdin.write("go\n")
        self._process.stdin.flush()

    def finish(self) -> Result:
        """What it measured."""
        assert self._process.stdout is not None
        for line in self._process.stdout:
            if line.startswith("{"):  # libraries print as well
                answer: Result = json.loads(line)
                return answer
        raise SkippedError(f"it ended with code {self._process.wait()}")

    def measure(self) -> Result:
        """One measurement, from start to end."""
        self.go()
        return self.finish()

    def close(self) -> None:
        """End the process, and whatever it has started: nothing more comes on its stdin."""
        assert self._process.stdin is not None
        try:
            self._process.stdin.close()
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(timeout=10)
        finally:
            self._tree.end()


def serve(prepare: Callable[[], Callable[[], Result]]) -> None:
    """The process's side of a case: prepare, say ready, measure once per line on stdin."""
    try:
        measure = prepare()
    except (ImportError, SkippedError) as error:
        say({"skipped": str(error)})
        return
    say({"ready": True})
    for _ in sys.stdin:
        say(measure())


def interleaved(
    measurements: Mapping[str, Callable[[], Result]], repeats: int
) -> dict[str, list[Result]]:
    """Every measurement once, then every one again, ...: what disturbs the machine hits all."""
    results: dict[str, list[Result]] = {name: [] for name in measurements}
    for _ in range(repeats):
        for name, measure in measurements.items():
            results[name].append(measure())
    return results


def median(results: Iterable[Result], name: str) -> float:
    """Median of one figure over the repeats."""
    return statistics.median(float(result[name]) for result in results)


def spread(results: Iterable[Result], name: str) -> str:
    """Median, smallest and largest of one figure over the repeats, for a table."""
    values = [float(result[name]) for result in results]
    return f"{_cell(statistics.median(values))} [{_cell(min(values))} .. {_cell(max(values))}]"


def usable_cores() -> list[int]:
    """Numbers of the cores that this process may use."""
    return sorted(os.sched_getaffinity(0))


def rss_mb(pid: int) -> float:
    """Resident memory of a process [MB]; 0 if it is gone."""
    try:
        pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    except (OSError, IndexError):
        return 0.0
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def command_line(doc: str | None) -> argparse.ArgumentParser:
    """A command line with the flags that all benchmarks have."""
    parser = argparse.ArgumentParser(description=(doc or "").partition("\n")[0])
    parser.add_argument(
        "--default-blas",
        action=_DefaultBlas,
        nargs=0,
        help=f"without {' and '.join(_FORCED_BLAS)}, for ours and all peers",
    )
    return parser


class _DefaultBlas(argparse.Action):
    """Run again without the variables: NumPy has read them already."""

    def __call__(self, *_: object) -> None:
        forced = [name for name in _FORCED_BLAS if os.environ.pop(name, None)]
        if forced:
            os.execv(sys.executable, [sys.executable, *sys.orig_argv[1:]])


def say(record: Result) -> None:
    """One JSON line."""
    print(json.dumps(record), flush=True)


def table(rows: Sequence[Result]) -> None:
    """The rows as aligned columns, under the names of the first row's fields."""
    if not rows:
        return
    lines = [list(rows[0]), *([_cell(row.get(name)) for name in rows[0]] for row in rows)]
    widths = [max(len(line[column]) for line in lines) for column in range(len(rows[0]))]
    print()
    for line in lines:
        print("  ".join(cell.rjust(width) for cell, width in zip(line, widths, strict=True)))


def _cell(value: object) -> str:
    if isinstance(value, float):
        return f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.3g}"
    return "-" if value is None else str(value)
