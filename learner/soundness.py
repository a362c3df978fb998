"""Is an answer what was asked for, and can it be believed?"""

import json
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dppo.gradients import Sums
from dppo.spaces import Spaces
from dppo.sums import Block, members
from dppo.wire.messages import Answer, Collected, Gradient, Measured

_WEIGHTS = 3
"""The first of `Sums`: samples."""


@dataclass(frozen=True, slots=True)
class Expected:
    """What decides the form of an answer."""

    spaces: Spaces
    parameter_count: int
    samples: int
    """Of one slot in one iteration [count]."""

    def objection(self, answer: Answer) -> str:
        """What is wrong with lengths and counts, in words; empty if nothing is."""
        kind = type(answer).__name__
        for name, length in self._lengths(answer).items():
            found = len(getattr(answer, name))
            if found != length:
                return f"sent {kind}.{name} of {found} numbers, expected {length}"
        for count, most in self._counts(answer):
            if count < 0 or count > most:
                return f"sent a {kind} over {count:g} samples, expected at most {most}"
        match answer:
            case Gradient() if not set(answer.stopped) <= set(members(block_of(answer))):
                return f"sent a Gradient of other slots than {answer.stopped}, which it stops"
            case Measured() if answer.weight == 0:
                return "sent a Measured over no samples"
            case Collected() if not _is_whole(answer.snapshot):
                return "sent a Collected whose snapshot is damaged"
        return ""

    def _lengths(self, answer: Answer) -> dict[str, int]:
        match answer:
            case Gradient():
                return {"vector": self.parameter_count, "sums": len(Sums.__slots__)}
            case Collected():
                return {
                    "obs": 1 + 2 * self.spaces.obs_size, "returns": 3, "advantages": 7, "fit": 7,
                    "sigma_target": 3, "start_sigma": 3,
                    "episodes": 2 * (len(answer.episodes) // 2),
                }  # fmt: skip
            case Measured():
                return {}

    def _counts(self, answer: Answer) -> list[tuple[float, int]]:
        """Counts of samples, each with the most that it can be (critics may learn twice)."""
        match answer:
            case Gradient():
                return [(float(n), 2 * answer.size * self.samples) for n in answer.sums[:_WEIGHTS]]
            case Collected():
                vectors = (answer.obs, answer.returns, answer.advantages)
                return [(float(vector[0]), self.samples) for vector in vectors]
            case Measured():
                return [(answer.weight, self.samples)]


def _is_whole(snapshot: bytes) -> bool:
    """Is it safetensors, to its last byte? What its arrays mean, only workers know."""
    start = 8 + int.from_bytes(snapshot[:8], "little")
    try:
        header = json.loads(snapshot[8:start])
        ends = [entry["data_offsets"][1] for entry in header.values() if "dtype" in entry]
    except (ValueError, KeyError, TypeError, AttributeError, IndexError):
        return False
    return start + max(ends, default=0) == len(snapshot)


def sizes(answer: Answer) -> dict[str, float]:
    """How large the numbers of an answer are, by what they are; nan or inf if one of them is."""
    with np.errstate(all="ignore"):
        return _sizes(answer)


def _sizes(answer: Answer) -> dict[str, float]:
    match answer:
        case Gradient():
            weight = max(float(answer.sums[0]), float(answer.sums[1]), 1.0)
            return {
                "gradient per sample": _norm(answer.vector) / weight,
                "loss per sample": _norm(answer.sums) / weight,
            }
        case Collected():
            moments = {
                "observation": answer.obs, "return": answer.returns, "sigma": answer.start_sigma,
                "advantage": answer.advantages, "fit": answer.fit, "target": answer.sigma_target,
            }  # fmt: skip
            found = {name: _greatest(vector) for name, vector in moments.items()}
            return found | {"episode": 0.0 * float(answer.episodes.sum())}  # of any size
        case Measured():
            return {"KL per sample": abs(answer.kl) / max(answer.weight, 1.0)}


def _norm(vector: NDArray[np.floating]) -> float:
    """Euclidean norm, quickly where float32 can hold its square."""
    square = float(np.dot(vector, vector))
    return float(np.linalg.norm(vector.astype(np.float64))) if square > 1e30 else square**0.5


def _greatest(moments: NDArray[np.float64]) -> float:
    """The greatest root mean square among the features of some moments."""
    size = (len(moments) - 1) // 2
    mean, m2 = moments[1 : 1 + size], moments[1 + size :]
    return float(np.sqrt(np.max(mean**2 + m2 / max(moments[0], 1.0))))


def block_of(answer: Answer) -> Block:
    """The slots that an answer is about."""
    return (answer.first, answer.size) if isinstance(answer, Gradient) else (answer.slot, 1)
