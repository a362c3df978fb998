"""Where a process spends its time: exclusive seconds by label, from timers around functions.

A timed function's time does not count for the timed function that calls it, so the labels add up
to the wall time. Functions are wrapped from outside; nothing in the packages knows of it.
"""

import importlib
import time
from collections import defaultdict
from collections.abc import Callable, Sequence
from functools import reduce
from typing import Any

REST = "other"
Place = tuple[str, str]
"""`package.module:Owner.function`, and its label."""


class Stopwatch:
    """Seconds by label since `reset`, in one thread."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)
        self._labels = [REST]
        self._since = time.perf_counter()

    def reset(self) -> None:
        """Begin anew, in whatever is under way."""
        self.seconds.clear()
        self._since = time.perf_counter()

    def read(self) -> dict[str, float]:
        """Seconds by label until now."""
        self.switch(self._labels[-1])
        self._labels.pop()
        return dict(self.seconds)

    def switch(self, label: str | None) -> None:
        """Enter a label, or (None) go back to the one before."""
        now = time.perf_counter()
        self.seconds[self._labels[-1]] += now - self._since
        self._since = now
        if label is None:
            self._labels.pop()
        else:
            self._labels.append(label)

    def timed(self, function: Callable[..., Any], label: str) -> Callable[..., Any]:
        """The function under a label."""

        def run(*args: Any, **kwargs: Any) -> Any:  # noqa: ANN401  any function
            self.switch(label)
            try:
                return function(*args, **kwargs)
            finally:
                self.switch(None)

        return run

    def put_on(self, places: Sequence[Place]) -> list[str]:
        """Wrap the functions, and what overrides them in subclasses that have been imported.

        Returns:
            The places that are not there in this version.
        """
        absent = []
        for place, label in places:
            module, _, path = place.partition(":")
            *owners, name = path.split(".")
            try:
                owner = reduce(getattr, owners, importlib.import_module(module))
                for each in [owner, *_overriding(owner, name)]:
                    setattr(each, name, self.timed(getattr(each, name), label))
            except (ImportError, AttributeError):
                absent.append(place)
        return absent


def _overriding(owner: Any, name: str) -> list[type]:  # noqa: ANN401  a module or a class
    """All subclasses with a function of that name of their own."""
    if not isinstance(owner, type):
        return []
    return [sub for sub in dict.fromkeys(_below(owner)) if name in vars(sub)]


def _below(owner: type) -> list[type]:
    direct: list[type] = owner.__subclasses__()
    return [each for sub in direct for each in (sub, *_below(sub))]
