"""Parts of a snapshot: what an environment's future depends on, as named arrays."""

import numpy as np
from numpy.typing import NDArray

Arrays = dict[str, NDArray[np.generic]]
_WORD = 1 << 64


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
