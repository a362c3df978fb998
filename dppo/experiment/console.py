"""Progress of a grid: a bar on a terminal, plain lines elsewhere."""

import contextlib
import sys
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Self

from dppo.process import clock

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
    running: tuple[tuple[float, str], ...]
    """What runs now: how far it is, 0 .. 1, and its name with a figure."""

    @property
    def figures(self) -> str:
        """How many runs."""
        failed = f", {self.failed} failed" if self.failed else ""
        return f"{self.done} of {self.runs} runs finished{failed}"


class Console:
    """Shows the standing."""

    def __init__(self) -> None:
        self._bar: Any = None
        self._rows: list[Any] = []
        """On the bar: the grid, and below it what runs."""
        self._last = -_PLAIN_SECONDS

    def __enter__(self) -> Self:
        """Begin to show."""
        if sys.stdout.isatty():
            from rich.progress import BarColumn, Progress, TextColumn

            self._bar = Progress(
                BarColumn(bar_width=20),
                TextColumn("{task.percentage:5.1f} %"),
                TextColumn("{task.description}", markup=False),
            )
            self._rows.append(self._bar.add_task("starting", total=1.0))
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
        whole = f"left {clock(standing.left)}  {standing.figures}"
        if self._bar is not None:
            self._show_rows([(standing.share, whole), *standing.running])
        elif now - self._last >= _PLAIN_SECONDS:
            self._last = now
            running = "  ".join(f"{text} {share:.0%}" for share, text in standing.running)
            self.say(f"{standing.share:6.1%}  {whole}  {running}")

    def _show_rows(self, rows: list[tuple[float, str]]) -> None:
        while len(self._rows) < len(rows):
            self._rows.append(self._bar.add_task("", total=1.0))
        for place, row in enumerate(self._rows):
            share, text = rows[place] if place < len(rows) else (0.0, "")
            self._bar.update(row, completed=share, description=text, visible=place < len(rows))
