"""Parts of a snapshot: what an environment's future depends on, as named arrays."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Arrays = dict[str, NDArray[np.generic]]
_WORD = 1 << 64


def packed(rows: Sequence[Arrays]) -> Arrays:
    """The arrays of several environments as few ones: it costs more to name one than to hold it.

    `name` has all rows in order, [n, ...]; where they differ in shape, `index/name` has one row.
    """
    arrays: Arrays = {}
    for name in dict.fromkeys(name for row in rows for name in row):
        parts = {index: row[name] for index, row in enumerate(rows) if name in row}
        alike = len({(part.shape, part.dtype) for part in parts.values()}) == 1
        if alike and len(parts) == len(rows):
            arrays[name] = np.stack(list(parts.values()))
        else:
            arrays |= {f"{index}/{name}": np.ascontiguousarray(a) for index, a in parts.items()}
    return arrays


def unpacked(arrays: Arrays, count: int) -> list[Arrays]:
    """The inverse; what belongs to no row is left out."""
    rows: list[Arrays] = [{} for _ in range(count)]
    for key, array in arrays.items():
        index, mark, name = key.partition("/")
        if not mark:
            for row, part in zip(rows, array, strict=True):
                row[key] = part
        elif index.isdecimal():
            rows[int(index)][name] = array
    return rows


def generator_state(rng: np.random.Generator) -> NDArray[np.uint64]:
    """[6] the state of a PCG64 generator, Gymnasium's kind."""
    state = rng.bit_generator.state
    numbers = state["state"]
    words = [word for name in ("state", "inc") for word in divmod(numbers[name], _WORD)]
    return np.array([*words, state["has_uint32"], state["uinteger"]], np.uint64)


def generator_from(words: NDArray[np.generic]) -> np.random.Generator:
    """The generator of a state."""
    high, low, inc_high, inc_low, has_uint32, uinteger = (int(word) for word in words)
    bits = np.random.PCG64()
    bits.state = {
        "bit_generator": "PCG64",
        "state": {"state": high * _WORD + low, "inc": inc_high * _WORD + inc_low},
        "has_uint32": has_uint32,
        "uinteger": uinteger,
    }
    return np.random.Generator(bits)
