"""Figures of sets of returns."""

import numpy as np
from numpy.typing import NDArray


def cvar(returns: NDArray[np.float64], fraction: float = 0.1) -> float:
    """Conditional value at risk: mean of the worst `fraction` of the returns, of at least one."""
    worst = np.sort(returns)[: max(1, int(np.ceil(fraction * len(returns))))]
    return float(worst.mean())
