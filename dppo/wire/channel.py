"""Frames over a stream of bytes between two processes of one host.

A frame travels as the lengths of header and body and the place of the body, then both; bodies lie
in shared memory (`shared_bodies`) where there is room.
"""

import socket
import struct
from collections.abc import Iterator

from dppo.errors import WireError
from dppo.wire.codec import MAX_BODY, MAX_HEADER, Frame, encode
from dppo.wire.messages import Message
from dppo.wire.shared_bodies import SharedBodies

_PREFIX = struct.Struct("<IIi")
_INLINE = -1
"""In place of a cell's number: the body follows the header."""
_READ_BYTES = 1 << 18


class Channel:
    """One end of a pair: frames in and out of a stream of bytes, bodies in shared memory."""

    def __init__(self, end: socket.socket, bodies: SharedBodies | None) -> None:
        self.end, self._bodies = end, bodies
        self._received = bytearray()

    def frames(self) -> Iterator[Frame]:
        """All frames that one read completes.

        Raises:
            EOFError: the other end is gone.
            WireError: what came cannot be the beginning of a frame.
        """
        try:
            data = self.end.recv(_READ_BYTES)
        except BlockingIOError:
            return
        except ConnectionError as error:
            raise EOFError from error
        if not data:
            raise EOFError
        self._received += data
        while (frame := self._next()) is not None:
            yield frame

    def _next(self) -> Frame | None:
        """The first whole frame among the received bytes."""
        if len(self._received) < _PREFIX.size:
            return None
        header, body, cell = _PREFIX.unpack_from(self._received)
        if header > MAX_HEADER or body > MAX_BODY:
            raise WireError(
                f"a frame of {header} + {body} bytes was announced, at most "
                f"{MAX_HEADER} + {MAX_BODY} are accepted"
            )
        middle = _PREFIX.size + header
        stop = middle + (body if cell == _INLINE else 0)
        if len(self._received) < stop:
            return None
        frame = Frame(
            bytes(self._received[_PREFIX.size : middle]),
            self._received[middle:stop] if cell == _INLINE else self._shared(cell, body),
        )
        del self._received[:stop]
        return frame

    def _shared(self, cell: int, length: int) -> bytearray:
        try:
            if self._bodies is None:
                raise ValueError("no memory is shared")
            return self._bodies.take(cell, length)
        except ValueError as error:
            raise WireError(f"a body was said to be in shared memory: {error}") from error

    def pieces(self, message: Message) -> list[memoryview]:
        """What to write for a message."""
        frame = encode(message)
        cell = None if self._bodies is None else self._bodies.put(frame.body)
        prefix = _PREFIX.pack(
            len(frame.header), len(frame.body), _INLINE if cell is None else cell
        )
        body = [memoryview(frame.body)] if cell is None and frame.body else []
        return [memoryview(prefix + frame.header), *body]


def without(pieces: list[memoryview], count: int) -> list[memoryview]:
    """What is left of the pieces when `count` bytes are gone."""
    for number, piece in enumerate(pieces):
        if count < len(piece):
            return [piece[count:], *pieces[number + 1 :]]
        count -= len(piece)
    return []
