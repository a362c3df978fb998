"""Running count, mean and sum of squared deviations, merged exactly.

Merging is Chan, Golub and LeVeque's pairwise update: the moments of a union from the moments of
its parts. Workers send moments, never averages of standard deviations. All in float64.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Moments:
    """Moments of a set of vectors of length F (F = 1 for scalars)."""

    count: float
    """Number of vectors."""
    mean: FloatArray  # [F]
    m2: FloatArray  # [F]  sum of squared deviations from the mean

    @classmethod
    def empty(cls, size: int) -> Self:
        """The moments of nothing."""
        return cls(0.0, np.zeros(size), np.zeros(size))

    @classmethod
    def of(cls, values: NDArray[np.floating]) -> Self:
        """The moments of the rows of `values`: [N, F], or [N] for scalars."""
        rows = np.asarray(values, np.float64)
        if rows.ndim == 1:
            rows = rows[:, None]
        if len(rows) == 0:
            return cls.empty(rows.shape[1])
        mean = rows.mean(axis=0)
        return cls(float(len(rows)), mean, np.square(rows - mean).sum(axis=0))

    def merge(self, other: "Moments") -> "Moments":
        """The moments of both sets together."""
        count = self.count + other.count
        if count == 0:
            return self
        delta = other.mean - self.mean
        mean = self.mean + delta * (other.count / count)
        m2 = self.m2 + other.m2 + np.square(delta) * (self.count * other.count / count)
        return Moments(count, mean, m2)

    def scaled(self, factor: float) -> "Moments":
        """The moments of the same vectors, each times `factor`."""
        return Moments(self.count, self.mean * factor, self.m2 * factor**2)

    def std(self, floor: float = 1e-8) -> FloatArray:
        """[F] population standard deviation; 1 where nothing was seen, at least `floor`."""
        if self.count == 0:
            return np.ones_like(self.mean)
        return np.maximum(np.sqrt(self.m2 / self.count), floor)

    def to_vector(self) -> FloatArray:
        """[1 + 2 F] count, mean, m2: the form that travels."""
        return np.concatenate([[self.count], self.mean, self.m2])

    @classmethod
    def from_vector(cls, vector: FloatArray) -> Self:
        """The inverse of `to_vector`."""
        size = (len(vector) - 1) // 2
        return cls(float(vector[0]), vector[1 : 1 + size].copy(), vector[1 + size :].copy())


def merged(vectors: Sequence[FloatArray]) -> Moments:
    """Of all sets together, from their `to_vector`, merged in this order; one set at least."""
    found = Moments.from_vector(vectors[0])
    for vector in vectors[1:]:
        found = found.merge(Moments.from_vector(vector))
    return found
