"""Random streams by counter: every draw belongs to (seed, purpose, indices), to nothing else.

No generator is carried from one iteration to the next, so a slot's draws do not depend on which
process asks for them, in which order, or how often (docs/design.md).
"""

from typing import Literal

import numpy as np

Purpose = Literal["init", "action", "minibatch", "reset", "evaluation", "four-rooms", "experiment"]
_PURPOSES: tuple[Purpose, ...] = (  # the place is the key: new ones at the end
    "init", "action", "minibatch", "reset", "evaluation", "four-rooms", "experiment",
)  # fmt: skip


def stream(seed: int, purpose: Purpose, *indices: int) -> np.random.Generator:
    """The generator of one purpose at one place of the run.

    Args:
        seed: the run's seed, 0 <= seed < 2**63.
        purpose: what the numbers are for.
        indices: up to three non-negative integers, such as (slot, iteration).

    Raises:
        ValueError: more than three indices.
    """
    if len(indices) > 3:
        raise ValueError(f"a stream takes at most 3 indices, found {len(indices)}: {indices}")
    counter = [0, *indices, *([0] * (3 - len(indices)))]  # the first word counts the draws
    bits = np.random.Philox(key=[seed, _PURPOSES.index(purpose)], counter=counter)
    return np.random.Generator(bits)


def reset_seed(seed: int, slot: int, env: int, episode: int) -> int:
    """The reset seed of one episode, in [0, 2**31)."""
    return int(stream(seed, "reset", slot, env, episode).integers(2**31))
