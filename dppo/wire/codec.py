"""Messages to bytes and back. The only place that knows msgpack.

A frame has two parts. The header is msgpack: [version, message name, field values]; a vector or
`bytes` field is there as its length only. The body is those fields' raw bytes, little-endian, one
after the other. Nothing is looked up outside the closed table of messages, and every length is
checked against the body before anything is allocated.
"""

import re
import struct
import zlib
from dataclasses import dataclass, fields
from typing import Any, get_args, get_type_hints

import msgpack
import numpy as np
from numpy.typing import NDArray

from dppo.errors import WireError
from dppo.wire.messages import VERSION, Hello, Message, Stop

MAX_HEADER = 1 << 20
"""Bytes of the longest header."""
MAX_BODY = 1 << 30
"""Bytes of the longest body."""
_SEAL = struct.Struct("<I")
_NAME = re.compile("[A-Za-z0-9-]{1,64}")
"""Of a worker: part of a key of Zenoh's, where other characters have meanings."""

_LASTING = Hello.__name__, Stop.__name__
"""Of any version: the two by which a mixed cluster is told that it is one."""
_TYPES: dict[str, type[Message]] = {kind.__name__: kind for kind in get_args(Message)}
_DTYPES: dict[Any, np.dtype[Any]] = {
    NDArray[np.float32]: np.dtype("<f4"),
    NDArray[np.float64]: np.dtype("<f8"),
    bytes: np.dtype("|u1"),
}
_SCALARS: dict[Any, type] = {int: int, float: float, str: str, bool: bool}


@dataclass(frozen=True, slots=True)
class _Field:
    """One field of a message, as it travels."""

    name: str
    where: str
    hint: Any
    dtype: np.dtype[Any] | None
    """Of its numbers in the body; None: it is in the header."""

    @property
    def is_bytes(self) -> bool:
        """`bytes`, not a vector."""
        return self.hint is bytes


_FIELDS = {
    name: tuple(
        _Field(field.name, f"{name}.{field.name}", hint, _DTYPES.get(hint))
        for field in fields(kind)
        for hint in [get_type_hints(kind)[field.name]]
    )
    for name, kind in _TYPES.items()
}


@dataclass(frozen=True, slots=True)
class Frame:
    """One message as it travels."""

    header: bytes
    body: bytes | bytearray


def encode(message: Message) -> Frame:
    """The frame of a message."""
    name = type(message).__name__
    values: list[Any] = []
    parts: list[Any] = []
    for field in _FIELDS[name]:
        value = getattr(message, field.name)
        if field.dtype is None:
            values.append(value)
            continue
        values.append(len(value))
        parts.append(value if field.is_bytes else np.ascontiguousarray(value, field.dtype).data)
    return Frame(msgpack.packb([VERSION, name, values]), b"".join(parts))


def decode(frame: Frame) -> Message:
    """The message of a frame.

    Raises:
        WireError: anything that is not exactly a message of this version, in one sentence.
    """
    kind, values = _header(frame)
    decoded: dict[str, Any] = {}
    start, body = 0, memoryview(frame.body)
    for field, value in zip(_FIELDS[kind.__name__], values, strict=True):
        if field.dtype is None:
            decoded[field.name] = _plain(field.where, field.hint, value)
            continue
        stop = start + _length(field.where, value) * field.dtype.itemsize
        if stop > len(body):
            raise WireError(f"{field.where} ends at byte {stop} of a body of {len(body)} bytes")
        part = body[start:stop]
        decoded[field.name] = (
            bytes(part) if field.is_bytes else np.frombuffer(part, field.dtype).copy()
        )
        start = stop
    if start != len(body):
        raise WireError(f"{kind.__name__} accounts for {start} of {len(body)} bytes of its body")
    worker = decoded.get("worker", "-")
    if not _NAME.fullmatch(worker):
        raise WireError(
            f"a {kind.__name__} of a worker called {worker[:80]!r}: letters, digits and '-' only"
        )
    return kind(**decoded)


def sealed(frame: Frame) -> bytes:
    """A frame's header with four bytes that tell whether header or body were damaged."""
    return frame.header + _seal(frame)


def unsealed(header: bytes, body: bytes) -> Frame:
    """The inverse of `sealed`: TCP's own sum misses one damage in 65,536.

    Raises:
        WireError: it is not what was sent.
    """
    frame = Frame(header[: -_SEAL.size], body)
    if header[-_SEAL.size :] != _seal(frame):
        raise WireError(
            f"{len(header)} + {len(body)} bytes do not match their checksum: damaged on the way, "
            "or from another dppo version"
        )
    return frame


def _seal(frame: Frame) -> bytes:
    return _SEAL.pack(zlib.crc32(frame.body, zlib.crc32(frame.header)))


def _header(frame: Frame) -> tuple[type[Message], list[Any]]:
    if len(frame.header) > MAX_HEADER or len(frame.body) > MAX_BODY:
        raise WireError(
            f"a frame has {len(frame.header)} + {len(frame.body)} bytes, "
            f"at most {MAX_HEADER} + {MAX_BODY} are accepted"
        )
    try:
        header = msgpack.unpackb(
            frame.header, strict_map_key=True, max_ext_len=0, max_map_len=0, max_bin_len=0
        )
    except Exception as error:  # msgpack raises a dozen kinds; all mean the same here
        raise WireError(f"a header is not msgpack: {error}") from error
    match header:
        case [int(version), str(name), list(values)] if version is not True:
            pass
        case _:
            raise WireError("a header is not [version, message name, field values]")
    if version != VERSION and not (name in _LASTING and len(values) == len(_FIELDS[name])):
        raise WireError(
            f"a message has protocol version {version}, this process speaks {VERSION}; "
            "install the same dppo version on learner and workers"
        )
    kind = _TYPES.get(name)
    if kind is None:
        raise WireError(f"{name[:40]!r} is no message of this protocol")
    if len(values) != len(_FIELDS[name]):
        raise WireError(f"{name} has {len(values)} fields, expected {len(_FIELDS[name])}")
    return kind, values


def _length(where: str, value: Any) -> int:  # noqa: ANN401  what msgpack gives
    if type(value) is not int or value < 0:
        raise WireError(f"{where} has length {value!r}, expected a whole number >= 0")
    return value


def _plain(where: str, hint: Any, value: Any) -> Any:  # noqa: ANN401  what msgpack gives
    if hint in _SCALARS:
        if type(value) is not _SCALARS[hint]:
            raise WireError(f"{where} is a {type(value).__name__}, expected {hint.__name__}")
        return value
    if type(value) is not list or any(type(item) is not int for item in value):
        raise WireError(f"{where} is {type(value).__name__}, expected a list of whole numbers")
    return tuple(value)
