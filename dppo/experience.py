"""What one slot learns from in one iteration: a table for the policy, one for the critics.

Shape letters: N samples · O observation size · A action size · K output size · F columns.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dppo.moments import FloatArray

Float32 = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Columns:
    """Where things stand in the rows of an `Experience`; views of tables [..., N, F]."""

    obs_size: int
    action_size: int
    output_size: int

    def obs(self, table: Float32) -> Float32:
        """[..., N, O], of either table."""
        return table[..., : self.obs_size]

    def action(self, table: Float32) -> Float32:
        """[..., N, A]."""
        return table[..., self.obs_size : self.obs_size + self.action_size]

    def output_old(self, table: Float32) -> Float32:
        """[..., N, K]."""
        return table[..., -2 - self.output_size : -2]

    def log_prob_old(self, table: Float32) -> Float32:
        """[..., N]."""
        return table[..., -2]

    def advantage(self, table: Float32) -> Float32:
        """[..., N]."""
        return table[..., -1]

    def targets(self, table: Float32, count: int) -> Float32:
        """[count, ..., N] of the critics' table: V's, then σ's if `count` is 2."""
        first = self.obs_size
        return np.moveaxis(table[..., first : first + count], -1, 0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Experience:
    """One slot's iteration, ready for its updates. N = T · E samples in time order.

    What an update needs of a sample stands in one row, so that a minibatch is one gather.
    """

    policy: Float32  # [N, O + A + K + 2]  see `Columns`
    critics: Float32  # [N or 2 N, O + 2]  with the previous iteration's samples if replayed
    columns: Columns
    log_std_old: Float32  # [A]
    a_v: FloatArray  # [N]
    a_sigma: FloatArray  # [N]

    @classmethod
    def of(
        cls,
        *,
        obs: Float32,
        action: Float32,
        output_old: Float32,
        log_prob_old: Float32,
        log_std_old: Float32,
        a_v: FloatArray,
        a_sigma: FloatArray,
        critics: Float32,
    ) -> "Experience":
        """The tables of some samples; `advantage` is NaN until the moments of all slots are known.

        Args:
            obs: [N, O].
            action: [N, A].
            output_old: [N, K] the policy's output before the updates.
            log_prob_old: [N].
            log_std_old: [A].
            a_v, a_sigma: [N].
            critics: see `critics_table`.
        """
        columns = Columns(obs.shape[1], action.shape[1], output_old.shape[1])
        unknown = np.full((len(obs), 1), np.nan, np.float32)
        last = log_prob_old[:, None]
        return cls(
            policy=np.concatenate([obs, action, output_old, last, unknown], axis=1),
            critics=critics,
            columns=columns,
            log_std_old=log_std_old,
            a_v=a_v,
            a_sigma=a_sigma,
        )

    @property
    def advantage(self) -> Float32:
        """[N] A, to be written once the moments over all slots are known."""
        return self.columns.advantage(self.policy)

    @property
    def is_complete(self) -> bool:
        """The advantage is known."""
        return not np.isnan(self.advantage[0])


def critics_table(obs: Float32, v_target: FloatArray, sigma_target: FloatArray) -> Float32:
    """[N, O + 2] what the critics learn from.

    Args:
        obs: [N, O], of the previous iteration too if it is replayed.
        v_target: [N].
        sigma_target: [N] in units of the variance network's output.
    """
    targets = np.stack([v_target, sigma_target], axis=1).astype(np.float32)
    return np.concatenate([obs, targets], axis=1)
