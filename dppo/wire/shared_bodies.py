"""Bodies of frames in memory that two processes share, so that no kernel copies them.

Each direction has a few cells. A sender fills a free cell and says its number on the socket; the
receiver copies the body out and frees the cell. A body that finds no free cell, or is too large
for one, goes through the socket. The memory has no name: it is gone with the last process that has
it.
"""

import mmap
import os
import platform

CELL_BYTES = 1 << 20
"""A gradient of a quarter of a million parameters."""
_CELLS = 2
_SIZE = _CELLS * (CELL_BYTES + 1)


class SharedBodies:
    """One end. The learner sends in the lower half and receives from the upper, a worker the
    other way round.
    """

    def __init__(self, descriptor: int, is_learner: bool) -> None:
        """`descriptor`: of the memory, from `new_memory`; not needed any more afterwards."""
        memory = memoryview(mmap.mmap(descriptor, 2 * _SIZE))
        lower, upper = memory[:_SIZE], memory[_SIZE:]
        self._out, self._in = (lower, upper) if is_learner else (upper, lower)

    def put(self, body: bytes | bytearray) -> int | None:
        """The number of the cell that holds the body now; None: send it another way."""
        if not 0 < len(body) <= CELL_BYTES:
            return None
        for cell in range(_CELLS):
            if not self._out[cell]:
                start = _CELLS + cell * CELL_BYTES
                self._out[start : start + len(body)] = body
                self._out[cell] = 1
                return cell
        return None

    def take(self, cell: int, length: int) -> bytearray:
        """A copy of the body in a cell, which is free from now on.

        Raises:
            ValueError: no such cell, or a longer body than it can hold.
        """
        if not (0 <= cell < _CELLS and 0 < length <= CELL_BYTES):
            raise ValueError(f"cell {cell} with {length} bytes: {_CELLS} of {CELL_BYTES} exist")
        start = _CELLS + cell * CELL_BYTES
        body = bytearray(self._in[start : start + length])
        self._in[cell] = 0
        return body


def new_memory() -> int | None:
    """The descriptor of memory for one pair; None where it cannot be used.

    A cell must not look free before it was read. x86 keeps that order of reads and writes; other
    processors need not, so bodies go through the socket there.
    """
    ordered = platform.machine().lower() in ("x86_64", "amd64")
    if not ordered or not hasattr(os, "memfd_create"):
        return None
    descriptor = None
    try:
        descriptor = os.memfd_create("dppo")
        os.ftruncate(descriptor, 2 * _SIZE)
        mmap.mmap(descriptor, 2 * _SIZE).close()
    except OSError:  # forbidden, or no room: the socket will do
        if descriptor is not None:
            os.close(descriptor)
        return None
    return descriptor
