"""Progress of a grid: a bar on a terminal, plain lines elsewhere."""

import contextlib
import sys
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Self

_PLAIN_SECONDS = 30.0
"""Plain lines come no faster than this."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Standing:
    """Where the whole grid stands."""

    share: float
    """Of the work, 0 .. 1."""
    left: float
    """Until the end [s]."""
    runs: int
    done: int
    failed: int
    running: tuple[str, ...]
    """What runs now, and how far it is."""

    @property
    def figures(self) -> str:
        """How many runs."""
        failed = f", {self.failed} failed" if self.failed else ""
        return f"{self.done} of {self.runs} runs finished{failed}"


class Console:
    """Shows the standing."""

    def __init__(self) -> None:
        self._bar: Any = None
        self._last = -_PLAIN_SECONDS

    def __enter__(self) -> Self:
        """Begin to show."""
        if sys.stdout.isatty():
            from rich.progress import BarColumn, Progress, TextColumn

            self._bar = Progress(
                BarColumn(bar_width=24),
                TextColumn("{task.percentage:5.1f} %"),
                TextColumn("left {task.fields[left]}  {task.fields[figures]}"),
                TextColumn("{task.fields[running]}"),
            )
            self._task = self._bar.add_task("grid", total=1.0, left="?", figures="", running="")
            self._bar.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Leave the terminal as it was."""
        if self._bar is not None:
            self._bar.stop()

    def say(self, text: str) -> None:
        """One line, above the bar if there is one."""
        if self._bar is not None:
            self._bar.console.print(text, highlight=False, markup=False)
            return
        # a full disk, a pipe that nobody reads: the line is lost, the grid goes on
        with contextlib.suppress(OSError):
            print(text, flush=True)

    def show(self, standing: Standing, now: float) -> None:
        """The newest standing; `now` in seconds on the caller's clock."""
        running = "  ".join(standing.running)
        if self._bar is not None:
            self._bar.update(
                self._task,
                completed=standing.share,
                left=clock(standing.left),
                figures=standing.figures,
                running=running,
            )
            return
        if now - self._last < _PLAIN_SECONDS:
            return
        self._last = now
        self.say(
            f"{standing.share:6.1%}  left {clock(standing.left)}  {standing.figures}  {running}"
        )


def clock(seconds: float) -> str:
    """`12:05:09`."""
    minutes, rest = divmod(int(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}"
