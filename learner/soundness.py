"""Is an answer what was asked for, and can it be believed?"""

import json
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dppo.gradients import Sums
from dppo.spaces import Spaces
from dppo.sums import Block, members
from dppo.wire.messages import Answer, Collected, Gradient, Measured, Ready

_WEIGHTS = 3
"""The first of `Sums`: samples."""
_MOST_SIZES = 1 << 24
"""Observations and actions together; more parameters than memory holds."""


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
            case Measured() if not answer.weights.all():
                return "sent a Measured over no samples"
            case Collected() if not _is_whole(answer.snapshot):
                return "sent a Collected whose snapshot is damaged"
            case Collected() if any(
                _squares(one).min(initial=0.0) < 0 for one in _moments(answer).values()
            ):
                return "sent a Collected with a sum of squares below 0"
        return ""

    def _lengths(self, answer: Answer) -> dict[str, int]:
        match answer:
            case Gradient():
                return {"vector": self.parameter_count, "sums": len(Sums.__slots__)}
            case Collected():
                return {
                    "obs": 1 + 2 * self.spaces.obs_size, "returns": 3, "reward": 3,
                    "advantages": 7, "fit": 7, "sigma_target": 3, "start_sigma": 3,
                    "episodes": 2 * (len(answer.episodes) // 2),
                }  # fmt: skip
            case Measured():
                return {"kls": answer.size, "weights": answer.size}

    def _counts(self, answer: Answer) -> list[tuple[float, int]]:
        """Counts of samples, each with the most that it can be (critics may learn twice)."""
        match answer:
            case Gradient():
                return [(float(n), 2 * answer.size * self.samples) for n in answer.sums[:_WEIGHTS]]
            case Collected():
                once = ("observation", "return", "reward", "advantage")
                return [
                    (float(vector[0]), self.samples if name in once else 2 * self.samples)
                    for name, vector in _moments(answer).items()
                ]
            case Measured():
                return [(float(weight), self.samples) for weight in answer.weights]


def odd_sizes(ready: Ready) -> str:
    """What cannot be right in a worker's report of its environment, in words; empty: nothing."""
    if ready.action_kind not in ("box", "discrete"):
        return f"sent a Ready with actions of the kind {ready.action_kind[:40]!r}"
    sizes_ = (ready.obs_size, *ready.action_sizes)
    if not ready.action_sizes or min(sizes_) < 1 or sum(sizes_) > _MOST_SIZES:
        return f"sent a Ready with the sizes {sizes_[:8]}, expected numbers from 1 up"
    return ""


def _is_whole(snapshot: bytes) -> bool:
    """Is it safetensors, to its last byte? What its arrays mean, only workers know."""
    start = 8 + int.from_bytes(snapshot[:8], "little")
    try:
        header = json.loads(snapshot[8:start])
        ends = [entry["data_offsets"][1] for entry in header.values() if "dtype" in entry]
        return bool(start + max(ends, default=0) == len(snapshot))
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError):
        return False


def magnitudes(answer: Answer) -> dict[str, float]:
    """How large the numbers of an answer are, by what they are; nan or inf if one of them is."""
    with np.errstate(all="ignore"):
        return _magnitudes(answer)


def _magnitudes(answer: Answer) -> dict[str, float]:
    match answer:
        case Gradient():
            weight = max(float(answer.sums[0]), float(answer.sums[1]), 1.0)
            return {
                "gradient per sample": _norm(answer.vector) / weight,
                "loss per sample": _norm(answer.sums) / weight,
            }
        case Collected():
            found = {name: _greatest(vector) for name, vector in _moments(answer).items()}
            return found | {"episode": 0.0 * float(answer.episodes.sum())}  # of any size
        case Measured():
            each = np.abs(answer.kls) / np.maximum(answer.weights, 1.0)
            return {"KL per sample": float(each.max())}


def _moments(answer: Collected) -> dict[str, NDArray[np.float64]]:
    """Counts, means and sums of squares, by what they are of."""
    return {
        "observation": answer.obs, "return": answer.returns, "reward": answer.reward,
        "advantage": answer.advantages, "fit": answer.fit, "target": answer.sigma_target,
        "sigma": answer.start_sigma,
    }  # fmt: skip


def _squares(moments: NDArray[np.float64]) -> NDArray[np.float64]:
    """The sums of squared deviations among some moments."""
    return moments[1 + (len(moments) - 1) // 2 :]


def _norm(vector: NDArray[np.floating]) -> float:
    """Euclidean norm, quickly where float32 can hold its square."""
    square = float(np.dot(vector, vector))
    return float(np.linalg.norm(vector.astype(np.float64))) if square > 1e30 else square**0.5


def _greatest(moments: NDArray[np.float64]) -> float:
    """The greatest root mean square among the features of some moments."""
    m2 = _squares(moments)
    mean = moments[1 : 1 + len(m2)]
    return float(np.sqrt(np.max(mean**2 + m2 / max(moments[0], 1.0))))


def block_of(answer: Answer) -> Block:
    """The slots that an answer is about."""
    return (answer.slot, 1) if isinstance(answer, Collected) else (answer.first, answer.size)
