"""Is an answer what was asked for? Shapes by the configuration, numbers finite."""

import numpy as np
from numpy.typing import NDArray

from dppo.gradients import Sums
from dppo.spaces import Spaces
from dppo.sums import Block
from dppo.wire.messages import Answer, Collected, Gradient, Measured


def shape_objection(answer: Answer, spaces: Spaces, parameter_count: int) -> str:
    """What is wrong with the answer's sizes, in words; empty if nothing is."""
    match answer:
        case Gradient():
            expected = {"vector": parameter_count, "sums": len(Sums.__slots__)}
        case Collected():
            expected = {
                "obs": 1 + 2 * spaces.obs_size, "returns": 3, "advantages": 7, "fit": 7,
                "sigma_target": 3, "start_sigma": 3, "episodes": 2 * (len(answer.episodes) // 2),
            }  # fmt: skip
        case Measured():
            expected = {}
    for name, length in expected.items():
        found = len(getattr(answer, name))
        if found != length:
            return f"sent {type(answer).__name__}.{name} of {found} numbers, expected {length}"
    return ""


def is_finite(answer: Answer) -> bool:
    """Are all numbers that would enter the run finite?"""
    vectors: list[NDArray[np.floating]]
    match answer:
        case Gradient():
            vectors = [answer.vector, answer.sums]
        case Collected():
            vectors = [
                answer.obs, answer.returns, answer.advantages, answer.fit, answer.sigma_target,
                answer.start_sigma, answer.episodes,
            ]  # fmt: skip
        case Measured():
            vectors = [np.array([answer.kl, answer.weight])]
    return all(np.isfinite(vector).all() for vector in vectors)


def block_of(answer: Answer) -> Block:
    """The slots that an answer is about."""
    return (answer.first, answer.size) if isinstance(answer, Gradient) else (answer.slot, 1)
