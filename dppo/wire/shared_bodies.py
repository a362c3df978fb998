"""Bodies of frames in memory that two processes share, so that no kernel copies them.

Each direction has a few slots. A sender fills a free slot and says its number on the socket; the
receiver copies the body out and frees the slot. A body that finds no free slot, or is too large
for one, goes through the socket. The memory has no name: it is gone with the last process that has
it.
"""

import mmap
import os

SLOT_BYTES = 1 << 20
"""A gradient of a quarter of a million parameters."""
_SLOTS = 2
_SIZE = _SLOTS * (SLOT_BYTES + 1)


class SharedBodies:
    """One end. The learner sends in the lower half and receives from the upper, a worker the
    other way round.
    """

    def __init__(self, descriptor: int, is_learner: bool) -> None:
        """`descriptor`: of the memory, from `new_memory`."""
        memory = memoryview(mmap.mmap(descriptor, 2 * _SIZE))
        lower, upper = memory[:_SIZE], memory[_SIZE:]
        self._out, self._in = (lower, upper) if is_learner else (upper, lower)

    def put(self, body: bytes | bytearray) -> int | None:
        """The number of the slot that holds the body now; None: send it another way."""
        if not 0 < len(body) <= SLOT_BYTES:
            return None
        for slot in range(_SLOTS):
            if not self._out[slot]:
                start = _SLOTS + slot * SLOT_BYTES
                self._out[start : start + len(body)] = body
                self._out[slot] = 1
                return slot
        return None

    def take(self, slot: int, length: int) -> bytearray:
        """A copy of the body in a slot, which is free from now on.

        Raises:
            ValueError: no such slot, or a longer body than it can hold.
        """
        if not (0 <= slot < _SLOTS and 0 < length <= SLOT_BYTES):
            raise ValueError(f"slot {slot} with {length} bytes: {_SLOTS} of {SLOT_BYTES} exist")
        start = _SLOTS + slot * SLOT_BYTES
        body = bytearray(self._in[start : start + length])
        self._in[slot] = 0
        return body


def new_memory() -> int | None:
    """The descriptor of memory for one pair; None where the system has none without a name."""
    if not hasattr(os, "memfd_create"):
        return None
    descriptor = os.memfd_create("dppo")
    os.ftruncate(descriptor, 2 * _SIZE)
    return descriptor
