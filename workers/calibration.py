"""Does σ know how far returns spread? Predicted against empirical standard deviation.

What is compared, in raw reward. σ(s) is meant to be the variance, given s, of the λ-return

    G_t = V(s_t) + Σ_l (γ λ_ret)^l δ_{t+l},        σ(s) = E[δ² + γ̄ σ(s')],  γ̄ = (γ λ_ret)²

with the run's γ and λ_ret; for λ_ret = 1 that is the discounted return, bootstrapped with V where
the time limit cuts it. Both agree if V is right: only then are the δ of an episode uncorrelated.

- From each start state: √σ(s_0) against the standard deviation of G_0 over episodes that share
  s_0. V(s_0) is the same in all of them, so an error of V at s_0 itself does not enter.
- Along the trajectories: σ(s_t) against (G_t − V(s_t))², which has the error of V at s_t in it.
  Steps that are too near a time limit for the spread that σ counts to show are left out, of all
  episodes: of those that fall alone they would stay, and make the spread too large.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dppo.errors import UsageError
from dppo.rollout import Rollout, estimates
from dppo.statistics import Measure, intervals
from dppo.statistics import spread as deviation
from dppo.streams import stream
from workers.play import Episode, Trajectory
from workers.policy import FrozenPolicy
from workers.spreads import Spread, far_from_limits

Float64 = NDArray[np.float64]
Interval = tuple[float, float]
_BOOTSTRAP = 2
"""Third index of the stream that intervals are drawn from; see `workers.play.Plan.noise`."""
_BINS = 10


@dataclass(frozen=True, slots=True, kw_only=True)
class FromStart:
    """One start state."""

    place: int
    episodes: int
    predicted_std: float
    """√σ(s_0) [reward]."""
    empirical_std: float
    """Of G_0 over the episodes [reward]."""
    empirical_std_interval: Interval
    ratio: float | None
    """Predicted over empirical; None: nothing spreads."""
    ratio_interval: Interval | None
    """None: too many of the resamples do not spread."""
    squares_std: float
    """Square root of the mean of Σ γ̄^l δ², which σ(s_0) is regressed on [reward]."""
    v_error: float
    """Mean of G_0 − V(s_0) [reward]."""
    discounted_std: float
    """Of Σ γ^t r_t, for comparison: a λ-return spreads less [reward]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Bin:
    """A tenth of all steps, by their σ."""

    steps: int
    predicted_std: float
    empirical_std: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Calibration:
    """Predicted against empirical standard deviations, with 95 % bootstrap intervals."""

    gamma: float
    lambda_ret: float
    starts: tuple[FromStart, ...]
    ratio: float | None
    """Over all start states: √(mean of σ(s_0) / mean of the empirical variances)."""
    ratio_interval: Interval | None
    along_ratio: float | None
    """Along the trajectories: √(mean of σ(s_t) / mean of (G_t − V(s_t))²); None: nothing shows."""
    along_ratio_interval: Interval | None
    along_squares_ratio: float | None
    """The same against the mean of Σ γ̄^l δ², which σ is trained on: errors of V are not in it."""
    bins: tuple[Bin, ...]

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self)


class Calibrator:
    """Takes episodes from fixed starts, one at a time; gives the calibration."""

    def __init__(self, policy: FrozenPolicy, max_steps: int = 0) -> None:
        """Refuse a run whose σ is not the variance of a return.

        Args:
            policy: that plays.
            max_steps: after so many its episodes are cut; 0: as the environment says.

        Raises:
            UsageError: says which setting.
        """
        returns = policy.config.returns
        if not policy.networks.has_variance:
            raise UsageError("the run has no variance critic (--no-variance-critic): no sigma")
        if returns.gamma_bar != "paper" or returns.delta_reward != "scaled":
            raise UsageError(
                f"the run has gamma_bar {returns.gamma_bar} and delta_reward "
                f"{returns.delta_reward}; expected paper and scaled: with others sigma is not the "
                "variance of a return, and there is nothing to compare it with"
            )
        trace = returns.return_trace
        exact = replace(returns, gae_lambda=trace, lambda_ret=trace, targets="monte-carlo")
        self._policy, self._max_steps = policy, max_steps
        self._config = replace(policy.config, returns=exact)
        self._found: dict[tuple[int, int], Spread] = {}

    def note(self, episode: Episode, trajectory: Trajectory) -> None:
        """One more episode, from a fixed start.

        Raises:
            UsageError: it was cut, and σ is that of episodes which are not.
        """
        is_cut = 0 < self._max_steps <= len(trajectory.reward) and not episode.terminated
        if is_cut and self._config.rollout.time_limit == "time-feature":
            raise UsageError(
                f"an episode was cut by --max-steps {self._max_steps} with --calibration, and the "
                "run has --time-limit time-feature: its sigma is of episodes up to the "
                "environment's own limit; leave one of the two out, or give more steps"
            )
        key = episode.plan.place, episode.plan.number
        self._found[key] = self._spread(episode, trajectory)

    def _spread(self, episode: Episode, trajectory: Trajectory) -> Spread:
        """σ and G − V at every step of an episode, in raw reward."""
        policy, config, steps = self._policy, self._config, len(trajectory.reward)
        seen = policy.seen(trajectory.obs, np.arange(steps + 1))
        last = np.arange(steps) == steps - 1
        over = episode.terminated or config.rollout.time_limit == "time-feature"
        rollout = Rollout(
            obs=seen[:-1, None],
            next_obs=seen[1:, None],
            action=np.empty((steps, 1, 0), np.float32),
            reward=trajectory.reward[:, None],
            terminated=(last & over)[:, None],
            ended=last[:, None],
            starts=(np.arange(steps) == 0)[:, None],
        )
        statistics = policy.statistics
        found = estimates(
            [rollout.judged(policy.mean_reward, config.safety)],
            seen[None, :-1],
            policy.networks,
            policy.parameters,
            statistics,
            config,
        ).of(0)
        scale, unit = statistics.reward_scale(config), statistics.sigma_unit(config)
        return Spread(
            sigma=found.sigma[:, 0] / unit,
            error=found.value.advantage[:, 0] / scale,
            squares=found.variance.target[:, 0] / unit,
            discounted=episode.discounted,
            is_cut=not over,
        )

    def result(self, seed: int) -> Calibration:
        """Of what was noted: the same number of episodes from each place, two at least."""
        places = sorted({place for place, _ in self._found})
        within = far_from_limits(self._found, self._config.returns.variance_discount)
        spreads = [
            [spread for (of, _), spread in sorted(within.items()) if of == place]
            for place in places
        ]
        rng = stream(seed, "evaluation", 0, 0, _BOOTSTRAP)
        starts = [
            _from_start(place, found, rng) for place, found in zip(places, spreads, strict=True)
        ]
        errors = np.array([[spread.error[0] for spread in found] for found in spreads])
        predicted = np.array([start.predicted_std for start in starts])
        ratio = _ratio_to(float(np.square(predicted).mean()))
        everything = [spread for found in spreads for spread in found]
        along = _along(everything)
        return Calibration(
            gamma=self._config.returns.gamma,
            lambda_ret=self._config.returns.return_trace,
            starts=tuple(starts),
            ratio=_finite(float(ratio(errors))),
            ratio_interval=_finite_bounds(intervals(errors.T, {"": ratio}, rng)[""]),
            along_ratio=_whole_ratio(along),
            along_ratio_interval=(
                _finite_bounds(intervals(along, {"": _ratio_along}, rng)[""])
                if len(along)
                else None
            ),
            along_squares_ratio=_whole_ratio(_along(everything, squares=True)),
            bins=_bins(everything),
        )


def _from_start(place: int, found: Sequence[Spread], rng: np.random.Generator) -> FromStart:
    """One start state."""
    sigma = max(0.0, float(found[0].sigma[0]))
    errors = np.array([[spread.error[0]] for spread in found])  # [N, 1]
    measures: dict[str, Measure] = {
        "std": lambda sample: deviation(sample)[..., 0],
        "ratio": _ratio_to(sigma),
    }
    bounds = intervals(errors, measures, rng)
    return FromStart(
        place=place,
        episodes=len(found),
        predicted_std=float(np.sqrt(sigma)),
        empirical_std=float(measures["std"](errors.T)),
        empirical_std_interval=bounds["std"],
        ratio=_finite(float(measures["ratio"](errors.T))),
        ratio_interval=_finite_bounds(bounds["ratio"]),
        squares_std=float(np.sqrt(np.mean([spread.squares[0] for spread in found]))),
        v_error=float(errors.mean()),
        discounted_std=float(np.std([spread.discounted for spread in found], ddof=1)),
    )


def _ratio_to(sigma: float) -> Measure:
    """√(σ / mean over places of the variance) of [..., places, N]; inf where nothing spreads."""
    return lambda sample: _root_ratio(sigma, np.square(deviation(sample)).mean(axis=-1))


def _root_ratio(sigma: Float64 | float, variance: Float64) -> Float64:
    """√(σ / variance), inf where there is no variance."""
    some = variance > 0
    return np.asarray(np.sqrt(np.where(some, sigma / np.where(some, variance, 1), np.inf)))


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _finite_bounds(bounds: Interval) -> Interval | None:
    return bounds if np.isfinite(bounds).all() else None


def _along(found: Sequence[Spread], *, squares: bool = False) -> Float64:
    """[N, 2] sums over the steps of each episode: of σ(s_t), and of (G_t − V(s_t))².

    With `squares`, of Σ γ̄^l δ² in place of the latter.
    """
    return np.array(
        [
            [part[: s.shown].sum() for part in (s.sigma, s.squares if squares else s.error**2)]
            for s in found
            if s.shown > 0
        ]
    ).reshape(-1, 2)


def _whole_ratio(along: Float64) -> float | None:
    return _finite(float(_ratio_along(along.T))) if len(along) else None


def _ratio_along(sample: Float64) -> Float64:
    """√(σ / squares) of sums [..., 2, N]; inf where there are none."""
    sigma, squares = sample[..., 0, :].sum(axis=-1), sample[..., 1, :].sum(axis=-1)
    return _root_ratio(np.maximum(sigma, 0), squares)


def _bins(found: Sequence[Spread]) -> tuple[Bin, ...]:
    """Tenths of all steps, from small σ to large."""
    sigma = np.concatenate([s.sigma[: s.shown] for s in found])
    squares = np.square(np.concatenate([s.error[: s.shown] for s in found]))
    order = np.argsort(sigma, kind="stable")
    return tuple(
        Bin(
            steps=len(part),
            predicted_std=float(np.sqrt(max(0.0, float(sigma[part].mean())))),
            empirical_std=float(np.sqrt(squares[part].mean())),
        )
        for part in np.array_split(order, _BINS)
        if len(part)
    )
