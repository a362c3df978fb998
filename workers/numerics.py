"""Does floating point give the same bits here as elsewhere? A hash to compare."""

import hashlib
from importlib.metadata import version

import numpy as np

from dppo.sources import code_hash
from dppo.streams import stream


def fingerprint() -> str:
    """Hash of a fixed computation through the kernels that training uses."""
    rng = stream(0, "init")
    x = rng.standard_normal((64, 64)).astype(np.float32)
    product = np.tanh(x @ x.T / 8) @ np.exp(x / 4)
    return hashlib.sha256(product.tobytes()).hexdigest()[:16]


def versions() -> str:
    """What else decides the bits: our own code, and versions of libraries."""
    names = ("numpy", "mujoco", "gymnasium")
    libraries = (f"{name} {version(name)}" for name in names)
    return ", ".join((f"code {code_hash()}", *libraries))
