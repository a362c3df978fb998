"""What a bad link does to a stream of bytes, as the two ends of a TCP connection see it.

TCP hides loss and order from its users, so a lost packet shows as bytes that come late, a
partition as bytes that come when it is over. Time is passed in; there is no socket here.
"""

import random
from collections import deque
from collections.abc import Collection
from dataclasses import dataclass
from typing import Literal

Direction = Literal["to-learner", "to-worker"]
DIRECTIONS: tuple[Direction, Direction] = ("to-learner", "to-worker")
DELAY_SECONDS = 0.2
SLOW_BYTES_PER_SECOND = 125_000.0
"""1 Mbit/s."""
LOSS = 0.2
HELD_SECONDS = 0.2
"""How long TCP takes to send a lost packet again, at least."""
CORRUPT = 0.2
"""Of the chunks of a link that corrupts: how many have a bit turned over."""


@dataclass(frozen=True, slots=True)
class Weather:
    """How one direction of a link is."""

    delay: float = 0.0
    """Of every byte [s]."""
    bytes_per_second: float = float("inf")
    loss: float = 0.0
    """Fraction of chunks that are held back, and whatever comes after them with them."""
    corrupt: float = 0.0
    """Fraction of chunks that have a bit turned over."""
    blocked: bool = False
    """Nothing passes; it comes later."""

    @classmethod
    def of(cls, kinds: Collection[str], direction: Direction) -> "Weather":
        """The weather while faults of these kinds last."""
        return cls(
            delay=DELAY_SECONDS if "delay" in kinds else 0.0,
            bytes_per_second=SLOW_BYTES_PER_SECOND if "slow" in kinds else float("inf"),
            loss=LOSS if "loss" in kinds else 0.0,
            corrupt=CORRUPT if f"corrupt-{direction}" in kinds else 0.0,
            blocked="partition" in kinds or f"partition-{direction}" in kinds,
        )


class Lane:
    """The bytes that are under way in one direction of one connection, in order."""

    def __init__(self, dice: random.Random) -> None:
        self._dice = dice
        self._chunks: deque[tuple[float, memoryview]] = deque()
        self._last = 0.0
        """When the newest chunk arrives."""
        self.held = 0
        """Bytes under way."""

    def put(self, data: bytes, now: float, weather: Weather) -> None:
        """Bytes set out."""
        if self._dice.random() < weather.corrupt:
            altered = bytearray(data)
            altered[self._dice.randrange(len(data))] ^= 1 << self._dice.randrange(8)
            data = bytes(altered)
        arrival = now + weather.delay
        if self._dice.random() < weather.loss:
            arrival += HELD_SECONDS
        self._last = max(self._last, arrival) + len(data) / weather.bytes_per_second
        self._chunks.append((self._last, memoryview(data)))
        self.held += len(data)

    def due(self, now: float, weather: Weather) -> memoryview | None:
        """The next bytes that have arrived."""
        if weather.blocked or not self._chunks or self._chunks[0][0] > now:
            return None
        return self._chunks[0][1]

    def taken(self, count: int) -> None:
        """So many of the bytes that were due have been passed on."""
        arrival, data = self._chunks.popleft()
        self.held -= count
        if count < len(data):
            self._chunks.appendleft((arrival, data[count:]))

    def next_arrival(self, weather: Weather) -> float:
        """When the next bytes arrive; infinity if none do as things are."""
        return self._chunks[0][0] if self._chunks and not weather.blocked else float("inf")
