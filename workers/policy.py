"""A checkpoint's policy, frozen: raw observations in, actions out.

Shape letters: n rows · O observation size · A action size · K numbers of noise per action.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dppo.config import RunConfig
from dppo.distributions import Distribution, distribution_of, mean_std
from dppo.errors import UsageError
from dppo.losses import sigma_of
from dppo.networks import Networks
from dppo.normalizer import with_clock
from dppo.schedules import in_iteration
from dppo.spaces import Spaces
from dppo.store.checkpoint import Checkpoint
from dppo.store.contents import config_in, mean_reward, spaces_in, statistics_in

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Outlook:
    """What the critics expect from a state on, if the policy goes on as in training."""

    value: Float64  # [n]
    """V: discounted return, with the run's γ [reward]."""
    std: Float64 | None  # [n]
    """√σ: standard deviation of the λ-return [reward]; None: the run has no variance critic."""


class FrozenPolicy:
    """A checkpoint's policy with its normaliser."""

    def __init__(
        self, checkpoint: Checkpoint, spaces: Spaces, run: RunConfig | None = None
    ) -> None:
        """For an environment with these `spaces`, that of `run`; None: of the policy's own.

        Raises:
            UsageError: the checkpoint was trained on other sizes.
        """
        config = in_iteration(config_in(checkpoint), checkpoint.facts["state"]["iteration"])
        self.config = config if run is None else replace(config, run=run)
        """The run's, with γ as it is there and the environment that the policy acts in."""
        trained = spaces_in(checkpoint)
        if trained != spaces:
            raise UsageError(
                f"the checkpoint's policy was trained on {trained}, the environment has {spaces}; "
                "give the environment that it was trained on"
            )
        self._obs_size = trained.obs_size
        self.distribution: Distribution = distribution_of(spaces)
        self.statistics = statistics_in(checkpoint)
        self.mean_reward = mean_reward(checkpoint)
        """Of a step, as in the iteration that comes after the checkpoint."""
        self.networks = Networks.build(spaces, self.config)
        self.parameters: Float32 = checkpoint.arrays["parameters"]
        self._normalizer = self.statistics.obs_normalizer(self.config.rollout)
        self._policy, self._log_std = self.networks.split_policy(self.parameters)

    @property
    def action_std(self) -> float | None:
        """Of sampled actions, mean over their dimensions; None: actions are choices."""
        return mean_std(self._log_std)

    def seen(self, obs: Float64, steps: NDArray[np.integer]) -> Float32:
        """[n, O] what the networks see of raw observations, `steps` [n] after the start.

        Raises:
            ValueError: observations of another size, or not one number of steps for each; a single
                number would fit by broadcasting.
        """
        if obs.shape[1:] != (self._obs_size,):
            raise ValueError(
                f"an observation has shape {obs.shape[1:]}, expected ({self._obs_size},), the "
                "flattened size of the environment that the policy was trained on"
            )
        if steps.shape != obs.shape[:1]:
            raise ValueError(f"steps have shape {steps.shape}, expected {obs.shape[:1]}")
        seen = self._normalizer(obs)
        has_clock = self.config.rollout.time_limit == "time-feature"
        return with_clock(seen, steps) if has_clock else seen

    def actions(self, obs: Float64, steps: NDArray[np.integer], noise: Float32 | None) -> Float32:
        """[n, A] actions for raw observations [n, O]: the most likely ones, or samples.

        One matrix product per row: a row's bits do not depend on the rows beside it.

        Args:
            obs: [n, O] flattened, not normalised.
            steps: [n] steps of the episodes so far, for policies with a time feature.
            noise: [n, K] draws of `distribution.noise`; None: the most likely actions.

        Raises:
            ValueError: observations of another size.
        """
        output, _ = self.networks.policy.forward(self._policy, self.seen(obs, steps)[:, None])
        if noise is None:
            return self.distribution.mode(output[:, 0])
        scaled = self.distribution.scaled(noise, self._log_std)
        return self.distribution.sample(output[:, 0], scaled)

    def act(self, obs: Float64, step: int, rng: np.random.Generator | None) -> Float32:
        """[A] action for one raw observation [O]; a sample if there is a generator.

        Raises:
            ValueError: an observation of another size.
        """
        noise = None if rng is None else self.distribution.noise(rng, (1,))
        (action,) = self.actions(np.asarray(obs)[None], np.array([step]), noise)
        return np.asarray(action)

    def outlook(self, obs: Float64, steps: NDArray[np.integer]) -> Outlook:
        """What the critics expect from raw observations [n, O] on, `steps` [n] after the start.

        In raw reward, with sampled actions. How far √σ can be trusted is what `dppo eval
        --calibration` tells. With --reward-variance, V is of the rewards with that penalty.

        Raises:
            ValueError: observations of another size.
        """
        networks, statistics, config = self.networks, self.statistics, self.config
        seen = self.seen(obs, steps)[:, None]
        value = networks.critic("value", self.parameters, seen)[:, 0].astype(np.float64)
        value /= statistics.reward_scale(config)
        if not networks.has_variance:
            return Outlook(value, None)
        output = networks.critic("variance", self.parameters, seen)[:, 0]
        sigma = sigma_of(output, config.safety).astype(np.float64)
        sigma *= statistics.sigma_scale(config)
        sigma /= statistics.sigma_unit(config)
        return Outlook(value, np.sqrt(np.maximum(0, sigma)))
