"""Progress of the experiment: a bar on a terminal, plain lines elsewhere."""

import sys
import time
from types import TracebackType
from typing import Any, Self

_PLAIN_SECONDS = 5.0
"""Plain lines come no faster than this."""


class Console:
    """Shows how many of all episodes have passed."""

    def __init__(self, episodes: int) -> None:
        self._done, self._all = 0, episodes
        self._bar: Any = None

    def __enter__(self) -> Self:
        """Begin to show."""
        self._shown = time.monotonic()
        if sys.stdout.isatty():
            from rich.progress import (
                BarColumn,
                MofNCompleteColumn,
                Progress,
                TextColumn,
                TimeRemainingColumn,
            )

            self._bar = Progress(
                BarColumn(bar_width=24),
                TextColumn("{task.percentage:5.1f} %"),
                TimeRemainingColumn(),
                MofNCompleteColumn(),
                TextColumn("episodes"),
            )
            self._task = self._bar.add_task("learn", total=self._all)
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
            self._bar.console.print(text, highlight=False)
        else:
            print(text, flush=True)

    def advance(self, episodes: int) -> None:
        """So many episodes more."""
        self._done += episodes
        if self._bar is not None:
            self._bar.update(self._task, completed=self._done)
            return
        now = time.monotonic()
        if self._done == self._all or now - self._shown >= _PLAIN_SECONDS:
            self._shown = now
            print(f"{self._done / self._all:6.1%}  {self._done:,} episodes", flush=True)
