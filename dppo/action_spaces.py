"""Which action spaces the trainer acts in, and how it sees them."""

from typing import Any, Literal

import numpy as np
from gymnasium import spaces

SUPPORTED = "Box of floats, Discrete and MultiDiscrete"


def kind_and_sizes(
    space: spaces.Space[Any],
) -> tuple[Literal["box", "discrete"], tuple[int, ...]] | None:
    """`action_kind` and `action_sizes` of `dppo.spaces.Spaces`; None: not supported."""
    match space:
        case spaces.Box() if space.shape and np.issubdtype(space.dtype, np.floating):
            return "box", (int(np.prod(space.shape)),)
        case spaces.Discrete():
            return "discrete", (int(space.n),)
        case spaces.MultiDiscrete():
            return "discrete", tuple(int(n) for n in space.nvec.ravel())
    return None
