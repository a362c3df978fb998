"""Progress as a bar on a terminal."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn


@contextmanager
def bar(episodes: int) -> Iterator[Callable[[int], None]]:
    """A function that advances the bar by some episodes."""
    columns = (
        BarColumn(bar_width=24),
        TextColumn("{task.percentage:5.1f} %"),
        TimeRemainingColumn(),
        MofNCompleteColumn(),
        TextColumn("episodes"),
    )
    with Progress(*columns) as progress:
        task = progress.add_task("learn", total=episodes)
        yield lambda more: progress.advance(task, more)
