"""Episodes of a frozen policy, several side by side in one vector environment.

Each episode has its own seeds, so that it is the same whatever is played beside it, in whichever
row, with however many rows.

Shape letters: n rows · O observation size · K numbers of noise per action.
"""

import logging
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from dppo.errors import RunFailedError
from dppo.streams import reset_seed, stream
from workers.envs import Adapter, name_of, training_vec
from workers.failures import RowFailedError, failed_episode, odd_row
from workers.policy import FrozenPolicy

log = logging.getLogger("evaluation")
Float64 = NDArray[np.float64]
Flags = NDArray[np.bool_]
Start = Literal["free", "fixed"]
ROWS = 16
"""Environments side by side; no number changes a result."""
_SLOT = 2**31
"""No slot of a training run has this number, so no start state is shared with training."""
_NOISE_STEPS = 64
"""Steps whose noise is drawn at once."""
_LONG_STEPS = 100_000
"""An episode that reaches so many is worth a word: it may never end."""


@dataclass(frozen=True, slots=True)
class Plan:
    """One episode before it is played."""

    seed: int
    """Of the evaluation."""
    start: Start
    """free: a start state of its own; fixed: the same one as others of the same `place`."""
    place: int
    """Which start state, if it is fixed."""
    number: int
    """Among the episodes of this start."""

    @property
    def reset_seed(self) -> int:
        """Of the start state."""
        if self.start == "free":
            return reset_seed(self.seed, _SLOT, 0, self.number)
        return reset_seed(self.seed, _SLOT, 1 + self.place, 0)

    @property
    def later_seed(self) -> int | None:
        """Of the environment's generator after the reset; None: it goes on as it is.

        Episodes from one start state differ in the environment's own noise, too.
        """
        if self.start == "free":
            return None
        return reset_seed(self.seed, _SLOT, 1 + self.place, 1 + self.number)

    def noise(self) -> np.random.Generator:
        """The stream of the actions' noise."""
        place = () if self.start == "free" else (1 + self.place,)
        return stream(self.seed, "evaluation", self.number, *place)


@dataclass(frozen=True, slots=True)
class Trajectory:
    """What one episode went through; empty arrays if that was not kept."""

    obs: Float64  # [T + 1, O]  raw, with the final one
    reward: Float64  # [T]


@dataclass(frozen=True, slots=True)
class Episode:
    """What became of a plan."""

    plan: Plan
    total: float
    """Undiscounted return [reward]."""
    discounted: float
    """Σ γ^t r_t, with the run's γ [reward]."""
    length: int
    """[env steps]."""
    terminated: bool
    """The task ended (a fall), rather than the time."""


def play(
    policy: FrozenPolicy,
    plans: Sequence[Plan],
    *,
    deterministic: bool = False,
    keep: bool = False,
    rows: int = ROWS,
    max_steps: int = 0,
) -> Iterator[tuple[Episode, Trajectory]]:
    """The episodes of some plans, as they end.

    Args:
        policy: and the run's settings.
        plans: at least one.
        deterministic: take the most likely actions.
        keep: fill the trajectories.
        rows: most environments side by side.
        max_steps: cut episodes after so many steps, as a time limit does; 0: the environment's
            own limit alone.

    Raises:
        RunFailedError: an environment raised, or returned what is not finite.
    """
    waves = -(-len(plans) // rows)
    stage = _Stage(policy, plans, -(-len(plans) // waves), deterministic, keep, max_steps)
    try:
        yield from stage.play()
    except RowFailedError as error:
        raise stage.failure(error.row, error.what) from error
    finally:
        stage.vec.close()


class _Stage:
    """Rows, and which plan each of them is at."""

    def __init__(
        self,
        policy: FrozenPolicy,
        plans: Sequence[Plan],
        rows: int,
        deterministic: bool,
        keep: bool,
        max_steps: int,
    ) -> None:
        self._policy, self._plans, self._keep = policy, plans, keep
        self._max_steps = max_steps
        self.vec = training_vec(policy.config.run, rows, remember=False)
        self._adapter = Adapter(self.vec.single_observation_space, self.vec.single_action_space)
        self._deterministic = deterministic
        self._generators = [plans[0].noise()] * rows
        width = policy.distribution.noise(plans[0].noise(), (1,)).shape[1]
        self._noise = np.zeros((rows, _NOISE_STEPS, width), np.float32)
        self._at = np.full(rows, -1)
        """Number of each row's plan; -1: none is left, the first one is played again meanwhile."""
        self._next = 0
        self.obs = np.zeros((rows, self._adapter.obs_size))
        self._steps = np.zeros(rows, np.int64)
        self._total, self._discounted, self._weight = np.zeros((3, rows))
        self._seen: list[list[Float64]] = [[] for _ in range(rows)]
        self._rewards: list[list[float]] = [[] for _ in range(rows)]

    def play(self) -> Iterator[tuple[Episode, Trajectory]]:
        """All plans; a row that is done takes the next one."""
        self._begin(np.ones(len(self._at), np.bool_))
        while (self._at >= 0).any():
            terminated, ended = self._step()
            if not ended.any():
                continue
            for row in np.flatnonzero(ended & (self._at >= 0)):
                yield self._result(int(row), bool(terminated[row]))
            self._begin(ended)

    def _begin(self, mask: Flags) -> None:
        """Reset some rows to the start of the plans that are next."""
        seeds: list[int | None] = [None] * len(mask)
        for row in map(int, np.flatnonzero(mask)):
            self._at[row] = self._next if self._next < len(self._plans) else -1
            self._next += 1
            plan = self._plan(row)
            seeds[row], self._generators[row] = plan.reset_seed, plan.noise()
            self._seen[row], self._rewards[row] = [], []
        found, _ = self.vec.reset(seed=seeds, options={"reset_mask": mask.copy()})
        for row in map(int, np.flatnonzero(mask)):
            later = self._plan(row).later_seed
            if later is not None:
                self.vec.reseed(row, later)
        self.obs = np.where(mask[:, None], self._flat(found), self.obs)
        for array, value in ((self._total, 0), (self._discounted, 0), (self._weight, 1)):
            array[mask] = value
        self._steps[mask] = 0
        self._check(np.zeros(len(mask)))

    def _plan(self, row: int) -> Plan:
        return self._plans[max(0, int(self._at[row]))]

    def _step(self) -> tuple[Flags, Flags]:
        """One step of all rows: which terminated, which ended one way or the other."""
        action = self._policy.actions(self.obs, self._steps, self._draw())
        if self._keep:
            for row, seen in enumerate(self._seen):
                seen.append(self.obs[row].copy())
        found, reward, terminated, truncated, _ = self.vec.step(self._adapter.to_envs(action))
        self.obs = self._flat(found)
        self._check(reward)
        self._steps += 1
        self._remark()
        self._total += reward
        self._discounted += self._weight * reward
        self._weight *= self._policy.config.returns.gamma
        if self._keep:
            for row, rewards in enumerate(self._rewards):
                rewards.append(float(reward[row]))
        if self._max_steps:
            truncated = truncated | (self._steps >= self._max_steps)
        return terminated, terminated | truncated

    def _remark(self) -> None:
        if self._steps.max() == _LONG_STEPS:
            log.warning(
                "an episode of %s has lasted %d steps; an environment without a time limit goes "
                "on until the policy ends it. Ctrl-C stops this; --max-steps 1000 cuts episodes "
                "after so many steps", name_of(self.vec), _LONG_STEPS,
            )  # fmt: skip

    def _draw(self) -> NDArray[np.float32] | None:
        """[n, K] each row's next noise, from its own stream."""
        if self._deterministic:
            return None
        place = self._steps % _NOISE_STEPS
        for row in np.flatnonzero(place == 0):
            draws = self._policy.distribution.noise(self._generators[row], (_NOISE_STEPS,))
            self._noise[row] = draws
        return self._noise[np.arange(len(place)), place]

    def _result(self, row: int, terminated: bool) -> tuple[Episode, Trajectory]:
        final = [self.obs[row]] if self._keep else []
        trajectory = Trajectory(np.array([*self._seen[row], *final]), np.array(self._rewards[row]))
        total, discounted = float(self._total[row]), float(self._discounted[row])
        steps = int(self._steps[row])
        return Episode(self._plan(row), total, discounted, steps, terminated), trajectory

    def _flat(self, found: NDArray[np.number]) -> Float64:
        return np.asarray(found, np.float64).reshape(len(self._at), -1)

    def _check(self, reward: Float64) -> None:
        """What is not finite is somebody's mistake, not a return."""
        row = odd_row(self.obs, reward)
        if row is not None:
            raise RowFailedError(row, "returned an observation or a reward that is not finite")

    def failure(self, row: int, what: str) -> RunFailedError:
        """The sentence for a row that failed."""
        seed = self._plan(row).reset_seed
        return failed_episode(name_of(self.vec), what, int(self._steps[row]), seed)
