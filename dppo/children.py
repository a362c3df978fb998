"""Child processes for a command's own work: a task goes in as JSON, answers come back on a pipe.

Each is `python -m module` in a session of its own, so Ctrl-C reaches it only from its parent. Its
stdin is the task on one line, and then what it lives by: when the other end closes, also by kill
-9 of the parent, it ends. An answer is the lengths of two parts, then both: facts as JSON, arrays
as safetensors. Two lengths of 0 say that this was the last one. Nothing is pickled.
"""

import json
import os
import select
import struct
import subprocess
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray
from safetensors.numpy import load, save

from dppo.machine import own_program

_LENGTHS = struct.Struct("<QQ")
_READ_BYTES = 1 << 18
_GO = b"\n"

Arrays = Mapping[str, NDArray[Any]]


@dataclass(frozen=True, slots=True)
class Answer:
    """What a child found out."""

    child: int
    """Its place among the tasks."""
    facts: dict[str, Any]
    arrays: Arrays


class Child:
    """The parent's side of one child."""

    def __init__(self, number: int, module: str, task: Any) -> None:  # noqa: ANN401  what JSON takes
        """Start it and give it its task."""
        self._number, self._received, self.has_finished = number, bytearray(), False
        self._process = subprocess.Popen(
            own_program(module),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            start_new_session=True,
        )
        self._write(json.dumps(task).encode() + b"\n")

    def go(self) -> None:
        """Let it begin, if it waits in `Parent.wait_for_go`."""
        self._write(_GO)

    def fileno(self) -> int:
        """Readable when there is an answer, or the end of all answers."""
        assert self._process.stdout is not None
        return self._process.stdout.fileno()

    def read(self) -> Iterator[Answer]:
        """All answers that one read completes.

        Raises:
            EOFError: it has ended before its last answer.
        """
        data = os.read(self.fileno(), _READ_BYTES)
        if not data:
            raise EOFError
        self._received += data
        while (answer := self._next()) is not None:
            yield answer

    def _next(self) -> Answer | None:
        """The first whole answer among the received bytes."""
        if len(self._received) < _LENGTHS.size:
            return None
        facts, arrays = _LENGTHS.unpack_from(self._received)
        middle = _LENGTHS.size + facts
        stop = middle + arrays
        if len(self._received) < stop:
            return None
        parts = bytes(self._received[_LENGTHS.size : middle]), bytes(self._received[middle:stop])
        del self._received[:stop]
        if not parts[0]:
            self.has_finished = True
            return None
        return Answer(self._number, json.loads(parts[0]), load(parts[1]) if parts[1] else {})

    def end(self) -> None:
        """Whatever it does: it keeps nothing that a signal could tear."""
        self._process.kill()
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            assert pipe is not None
            with suppress(BrokenPipeError):  # a part of its task that it did not take
                pipe.close()

    def _write(self, data: bytes) -> None:
        assert self._process.stdin is not None
        with suppress(BrokenPipeError):  # `read` finds out that it has ended
            self._process.stdin.write(data)
            self._process.stdin.flush()


@contextmanager
def children(module: str, tasks: Sequence[Any]) -> Iterator[list[Child]]:
    """A child for each task; with the block they end."""
    started: list[Child] = []
    try:
        for number, task in enumerate(tasks):
            started.append(Child(number, module, task))
        yield started
    finally:
        for child in started:
            child.end()


def answers(started: Sequence[Child], patience: float | None = None) -> Iterator[Answer]:
    """What they answer, as it comes, until each has given its last.

    Raises:
        EOFError: one of them has ended before its last.
        TimeoutError: none has answered for `patience` seconds.
    """
    poll, going = select.poll(), {child.fileno(): child for child in started}
    for child in started:
        poll.register(child, select.POLLIN)
    while going:
        ready = poll.poll(None if patience is None else 1000 * patience)
        if not ready:
            raise TimeoutError
        for descriptor, _ in ready:
            yield from going[descriptor].read()
            if going[descriptor].has_finished:
                poll.unregister(going.pop(descriptor))


class Parent:
    """The child's side. Make it first of all: from then on this process ends with its parent."""

    def __init__(self) -> None:
        """Take over stdin and stdout: whatever else reads or prints here gets others."""
        self._in, self._out = os.dup(0), os.dup(1)
        nothing = os.open(os.devnull, os.O_RDONLY)
        os.dup2(nothing, 0)
        os.close(nothing)
        os.dup2(2, 1)
        self.task: Any = json.loads(self._line())
        self._may_go = threading.Event()
        threading.Thread(target=self._watch, daemon=True).start()

    def wait_for_go(self) -> None:
        """Until the parent says so."""
        self._may_go.wait()

    def answer(self, facts: dict[str, Any], arrays: Arrays | None = None) -> None:
        """Send one."""
        self._send(json.dumps(facts).encode(), save(dict(arrays)) if arrays else b"")

    def finish(self) -> None:
        """Say that there are no more answers."""
        self._send(b"", b"")

    def _send(self, facts: bytes, arrays: bytes) -> None:
        left = memoryview(_LENGTHS.pack(len(facts), len(arrays)) + facts + arrays)
        while left:
            left = left[os.write(self._out, left) :]

    def _line(self) -> bytes:
        """The task. Nothing comes behind it before this process has answered."""
        line = b""
        while not line.endswith(b"\n"):
            piece = os.read(self._in, _READ_BYTES)
            if not piece:
                os._exit(0)
            line += piece
        return line

    def _watch(self) -> None:
        """Wait for the other end to close, whatever the rest of this process does meanwhile."""
        while os.read(self._in, 1):
            self._may_go.set()
        os._exit(0)
