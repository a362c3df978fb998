"""A TCP proxy on loopback between one worker and the learner: a link with weather.

Each connection that comes in is one more to the learner, whoever listens there by then, so the
proxy outlives learners. While a direction is blocked no connection is accepted: its handshake
would not pass either.
"""

import contextlib
import random
import selectors
import socket
import threading
import time
from collections.abc import Collection

from dppo.chaos.weather import DIRECTIONS, Direction, Lane, Weather

_CHUNK = 4096
_MOST_HELD = 64 * 1024
"""Bytes under way per direction, and about what each socket buffers: a short pipe, as a slow link
is. With loopback's megabytes a slow link would be a deep queue instead."""
_TICK = 0.05
_CLEAR = {direction: Weather() for direction in DIRECTIONS}


class _Connection:
    """A worker's connection and the one to the learner that belongs to it."""

    def __init__(self, worker: socket.socket, learner: socket.socket, dice: random.Random) -> None:
        self.ends: dict[Direction, socket.socket] = {"to-learner": learner, "to-worker": worker}
        """By where bytes go."""
        self.lanes: dict[Direction, Lane] = {name: Lane(dice) for name in DIRECTIONS}
        self.ended: set[Direction] = set()
        """Directions whose sender has said its last."""
        for end in self.ends.values():
            end.setblocking(False)
            end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def pump(self, now: float, weather: dict[Direction, Weather]) -> bool:
        """Move what can be moved, without waiting; is the connection still of use?"""
        for direction in DIRECTIONS:
            source = self.ends["to-worker" if direction == "to-learner" else "to-learner"]
            try:
                self._receive(source, direction, now, weather[direction])
                self._send(direction, now, weather[direction])
            except OSError:
                return False
            if direction in self.ended and not self.lanes[direction].held:
                return weather[direction].blocked  # its end arrives when the way is free again
        return True

    def _receive(
        self, source: socket.socket, direction: Direction, now: float, weather: Weather
    ) -> None:
        lane = self.lanes[direction]
        while not weather.blocked and direction not in self.ended and lane.held < _MOST_HELD:
            try:
                data = source.recv(_CHUNK)
            except BlockingIOError:
                return
            if data:
                lane.put(data, now, weather)
            else:
                self.ended.add(direction)

    def _send(self, direction: Direction, now: float, weather: Weather) -> None:
        lane = self.lanes[direction]
        while (data := lane.due(now, weather)) is not None:
            try:
                lane.taken(self.ends[direction].send(data))
            except BlockingIOError:
                return

    def wishes(self, weather: dict[Direction, Weather], now: float) -> dict[socket.socket, int]:
        """What each end has to be watched for."""
        events = {}
        for direction in DIRECTIONS:
            other: Direction = "to-worker" if direction == "to-learner" else "to-learner"
            back, ahead = self.lanes[other], self.lanes[direction]
            reads = not weather[other].blocked and back.held < _MOST_HELD
            writes = ahead.held > 0 and ahead.next_arrival(weather[direction]) <= now
            events[self.ends[direction]] = (
                selectors.EVENT_READ * (reads and other not in self.ended)
                | selectors.EVENT_WRITE * writes
            )
        return events

    def close(self) -> None:
        """Both ends, at once; what is under way is lost."""
        for end in self.ends.values():
            end.close()


class Proxy:
    """The link of one worker; a thread moves its bytes."""

    def __init__(self, learner_port: int, seed: int = 0) -> None:
        self._target = ("127.0.0.1", learner_port)
        self._dice = random.Random(seed)
        self._server = _small_buffers(socket.socket())
        self._server.bind(("127.0.0.1", 0))
        self._server.listen(16)
        self._server.setblocking(False)
        self.port: int = self._server.getsockname()[1]
        self._weather: dict[Direction, Weather] = _CLEAR
        self._moving = threading.Lock()
        """Held while bytes move, and while what decides on them changes."""
        self._connections: list[_Connection] = []
        self._over = False
        self._thread = threading.Thread(target=self._run, name=f"proxy-{self.port}", daemon=True)
        self._thread.start()

    @property
    def address(self) -> str:
        """What the worker connects to."""
        return f"tcp/127.0.0.1:{self.port}"

    @property
    def connections(self) -> int:
        """Connections that stand now."""
        return len(self._connections)

    def set(self, kinds: Collection[str]) -> None:
        """From now on the link is as faults of these kinds make it; none: clear."""
        with self._moving:
            self._weather = {direction: Weather.of(kinds, direction) for direction in DIRECTIONS}

    def cut(self) -> None:
        """Every connection that stands breaks; new ones are made."""
        with self._moving:
            self._keep([])

    def close(self) -> None:
        """End it, with all connections."""
        self._over = True
        self._thread.join()

    def _run(self) -> None:
        with self._server:
            while not self._over:
                with self._moving:
                    selector, patience = self._watched()
                with selector:
                    selector.select(patience)
                with self._moving:
                    self._move()
            self._keep([])

    def _move(self) -> None:
        weather, now = self._weather, time.monotonic()
        if not any(way.blocked for way in weather.values()):
            self._accept()
        self._keep([one for one in self._connections if one.pump(now, weather)])

    def _keep(self, connections: list[_Connection]) -> None:
        """Close all others."""
        for connection in self._connections:
            if connection not in connections:
                connection.close()
        self._connections = connections

    def _accept(self) -> None:
        with contextlib.suppress(BlockingIOError):
            while True:
                worker, _ = self._server.accept()
                learner = _small_buffers(socket.socket())
                try:
                    learner.settimeout(1.0)
                    learner.connect(self._target)  # on loopback: at once, or refused
                except OSError:
                    worker.close()
                    learner.close()
                    continue
                self._connections.append(_Connection(worker, learner, self._dice))

    def _watched(self) -> tuple[selectors.BaseSelector, float]:
        """What to wait for, and how long at most: the weather may change meanwhile."""
        weather, now = self._weather, time.monotonic()
        arrivals = [
            lane.next_arrival(weather[direction])
            for connection in self._connections
            for direction, lane in connection.lanes.items()
        ]
        later = [arrival for arrival in arrivals if arrival > now]
        selector = selectors.DefaultSelector()
        if not any(way.blocked for way in weather.values()):
            selector.register(self._server, selectors.EVENT_READ)
        for connection in self._connections:
            for end, events in connection.wishes(weather, now).items():
                if events:
                    selector.register(end, events)
        return selector, max(0.0, min([_TICK, *(arrival - now for arrival in later)]))


def _small_buffers(endpoint: socket.socket) -> socket.socket:
    """Before it connects or listens: accepted sockets have the listener's."""
    endpoint.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _MOST_HELD)
    endpoint.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _MOST_HELD)
    return endpoint
