"""Figures of an arm, with intervals from resampling its trials.

N trials, E episodes, W the last 200 of them, R resamples.
"""

from typing import Any

import numpy as np

from dppo.four_rooms.draws import generator_of
from dppo.four_rooms.experiment import ArmOutcome
from dppo.four_rooms.mdp import Floats, Mdp
from dppo.four_rooms.oracle import evaluate
from dppo.four_rooms.world import MAX_STEPS
from dppo.statistics import cvar

LAST = 200
"""Episodes that the figures describe: the last ones."""
RESAMPLES = 10_000
POINT = 20
"""Episodes behind one point of a learning curve."""
GOOD_RETURN = 30.0
"""A learning curve that stays above this has learned to reach the goal."""


class Bootstrap:
    """95 % intervals. Every arm uses the same resamples, as trial k of every arm shares draws."""

    def __init__(self, trials: int, seed: int) -> None:
        picks = generator_of(seed, "bootstrap", 0, 0).integers(trials, size=(RESAMPLES, trials))
        self._weights = np.apply_along_axis(np.bincount, 1, picks, minlength=trials) / trials

    def means(self, values: Floats) -> Floats:
        """[R] means of [N] values over the resampled trials."""
        return self._weights @ values

    def spreads(self, returns: Floats) -> Floats:
        """[R] standard deviations across trials, averaged over episodes, of [N, W] returns.

        A resample holds some trials twice, so its variance is too small by (N - 1) / N on average.
        """
        mean = self._weights @ returns
        square = self._weights @ returns**2
        variance = np.maximum(square - mean**2, 0) * len(returns) / max(len(returns) - 1, 1)
        spreads: Floats = np.sqrt(variance).mean(axis=1)
        return spreads

    @staticmethod
    def interval(resampled: Floats) -> list[float]:
        """The middle 95 %."""
        return [float(end) for end in np.quantile(resampled, (0.025, 0.975))]


def summarise(outcome: ArmOutcome, mdp: Mdp, bootstrap: Bootstrap) -> dict[str, Any]:
    """One arm of results.json."""
    agent = outcome.arm.agent
    returns = outcome.returns[:, -LAST:]
    exact = [
        [evaluate(mdp, policy, agent.gamma, trace) for policy in outcome.policies]
        for trace in (agent.lambda_ret, 1.0)
    ]
    by_trial = {
        "return_mean": returns.mean(axis=1),
        "return_std_within": returns.std(axis=1),
        "frozen_steps_per_episode": outcome.frozen[:, -LAST:].mean(axis=1),
        "timeouts_fraction": (outcome.lengths[:, -LAST:] == MAX_STEPS).mean(axis=1),
        "steps_per_episode": outcome.lengths[:, -LAST:].mean(axis=1),
        "exact_value_mean": np.array([mdp.start @ one.v for one in exact[0]]),
        "exact_sigma_mean": np.array([mdp.start @ one.sigma for one in exact[0]]),
        "exact_sigma_full_return_mean": np.array([mdp.start @ one.sigma for one in exact[1]]),
    }
    means = {name: float(values.mean()) for name, values in by_trial.items()}
    intervals = {
        name: bootstrap.interval(bootstrap.means(values)) for name, values in by_trial.items()
    }
    return {
        "key": outcome.arm.key,
        "title": outcome.arm.title,
        "psi": agent.psi,
        "return_std_across_trials": float(returns.std(axis=0).mean()),
        "return_std_of_trial_means": float(by_trial["return_mean"].std()),
        "return_cvar10": cvar(returns.ravel()),
        **means,
        "episodes_to_good_return": episodes_to(GOOD_RETURN, outcome.returns.mean(axis=0)),
        "intervals_95": intervals
        | {"return_std_across_trials": bootstrap.interval(bootstrap.spreads(returns))},
        "by_trial": {name: _rounded(values) for name, values in by_trial.items()},
        "curve": {
            name: _rounded(np.array(values))
            for name, values in zip(
                ("episode", "mean", "std"), curve(outcome.returns), strict=True
            )
        },
    }


def curve(returns: Floats) -> tuple[Floats, Floats, Floats]:
    """Episode, mean and standard deviation across trials; each point from POINT episodes."""
    width = min(POINT, returns.shape[1])
    points = returns.shape[1] // width

    def averaged(values: Floats) -> Floats:
        means: Floats = values[: points * width].reshape(points, width).mean(axis=1)
        return means

    episode = averaged(np.arange(1.0, returns.shape[1] + 1))
    return episode, averaged(returns.mean(axis=0)), averaged(returns.std(axis=0))


def episodes_to(level: float, mean_return: Floats) -> int | None:
    """Episodes until the mean returns [E] stay at or above `level`; None: they never do."""
    width = min(POINT, len(mean_return))
    _, smooth, _ = curve(mean_return[None])
    below = np.flatnonzero(smooth < level)
    first = 0 if len(below) == 0 else int(below[-1]) + 1
    return None if first == len(smooth) else first * width


def compare(plain: ArmOutcome, safe: ArmOutcome, bootstrap: Bootstrap) -> dict[str, Any]:
    """The safe arm against the plain one: difference of returns, ratios of spread and frozen."""
    returns = [arm.returns[:, -LAST:] for arm in (plain, safe)]
    frozen = [arm.frozen[:, -LAST:].mean(axis=1) for arm in (plain, safe)]
    gain = bootstrap.means(returns[1].mean(axis=1)) - bootstrap.means(returns[0].mean(axis=1))
    spread = bootstrap.spreads(returns[1]) / np.maximum(bootstrap.spreads(returns[0]), 1e-12)
    ice = bootstrap.means(frozen[1]) / np.maximum(bootstrap.means(frozen[0]), 1e-12)
    return {
        "return_difference": float(returns[1].mean() - returns[0].mean()),
        "return_std_ratio": float(
            returns[1].std(axis=0).mean() / max(returns[0].std(axis=0).mean(), 1e-12)
        ),
        "frozen_steps_ratio": float(frozen[1].mean() / max(frozen[0].mean(), 1e-12)),
        "intervals_95": {
            "return_difference": bootstrap.interval(gain),
            "return_std_ratio": bootstrap.interval(spread),
            "frozen_steps_ratio": bootstrap.interval(ice),
        },
    }


def _rounded(values: Floats) -> list[float]:
    """Enough digits for any figure; a file of half the size."""
    return [round(float(value), 4) for value in values]
