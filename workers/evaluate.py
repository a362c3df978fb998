"""Returns of a frozen policy: what `dppo eval` prints."""

import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from dppo.config import Config
from dppo.distributions import distribution_of
from dppo.errors import RunFailedError, UsageError
from dppo.networks import Networks
from dppo.statistics import cvar
from dppo.store.checkpoint import Checkpoint
from dppo.store.contents import spaces_in, statistics_in
from dppo.streams import reset_seed, stream
from workers.envs import Adapter, Env, make_env, spaces_of

_EVALUATION_SLOT = 2**31
"""No slot of a training run has this number, so no start state is shared with training."""


@dataclass(frozen=True, slots=True)
class Evaluation:
    """Undiscounted returns of a policy over several episodes."""

    returns: tuple[float, ...]
    lengths: tuple[int, ...]

    def summary(self) -> dict[str, float]:
        """Mean, spread and tail."""
        returns = np.array(self.returns)
        return {
            "episodes": len(returns),
            "return_mean": float(returns.mean()),
            "return_std": float(returns.std()),
            "return_cvar10": cvar(returns),
            "return_min": float(returns.min()),
            "return_max": float(returns.max()),
            "length_mean": float(np.mean(self.lengths)),
        }

    def to_json(self) -> str:
        """Summary and every episode."""
        return json.dumps(self.summary() | asdict(self), indent=2)


class FrozenPolicy:
    """A checkpoint's policy with its normaliser: observations in, actions out."""

    def __init__(self, checkpoint: Checkpoint, env: Env) -> None:
        self.config = Config.from_dict(checkpoint.facts["config"])
        spaces = spaces_of(env)
        trained = spaces_in(checkpoint)
        if trained.obs_size != spaces.obs_size:
            raise UsageError(
                f"the checkpoint's policy sees {trained.obs_size} numbers, the environment gives "
                f"{spaces.obs_size}"
            )
        self._normalizer = statistics_in(checkpoint).obs_normalizer(self.config.rollout)
        self._networks = Networks.build(spaces, self.config)
        self._distribution = distribution_of(spaces)
        self._policy, self._log_std = self._networks.split_policy(checkpoint.arrays["parameters"])

    def act(
        self, obs: NDArray[np.float64], step: int, rng: np.random.Generator | None
    ) -> NDArray[np.float32]:
        """[A] action for a raw observation [O]; the mode, or a sample if there is a generator.

        Args:
            obs: [O] flattened, not normalised.
            step: steps of the episode so far, for policies with a time feature.
            rng: source of the action's noise.
        """
        seen = self._normalizer(obs[None])
        if self.config.rollout.time_limit == "time-feature":
            seen = np.concatenate([seen, np.array([[0.001 * step]], np.float32)], axis=1)
        output, _ = self._networks.policy.forward(self._policy, seen)
        if rng is None:
            return self._distribution.mode(output).reshape(-1)
        noise = self._distribution.noise(rng, (1,))
        return self._distribution.sample(output, self._log_std, noise).reshape(-1)


def evaluate(
    checkpoint: Checkpoint, *, episodes: int, deterministic: bool, seed: int
) -> Evaluation:
    """Run the policy for some episodes, each from a start state of its own.

    Equal arguments give equal returns.
    """
    env = make_env(Config.from_dict(checkpoint.facts["config"]).run)
    policy = FrozenPolicy(checkpoint, env)
    try:
        results = [
            _episode(policy, env, None if deterministic else rng, start)
            for start, rng in _starts(seed, episodes)
        ]
    except Exception as error:  # an environment may raise anything
        name = env.spec.id if env.spec else type(env).__name__
        raise RunFailedError(f"{name} raised {type(error).__name__}: {error}") from error
    env.close()
    return Evaluation(tuple(score for score, _ in results), tuple(length for _, length in results))


def _starts(seed: int, episodes: int) -> Iterator[tuple[int, np.random.Generator]]:
    for episode in range(episodes):
        yield (
            reset_seed(seed, _EVALUATION_SLOT, 0, episode),
            stream(seed, "evaluation", episode),
        )


def _episode(
    policy: FrozenPolicy, env: Env, rng: np.random.Generator | None, start: int
) -> tuple[float, int]:
    """Return and length of one episode."""
    adapter = Adapter(env.observation_space, env.action_space)
    observation, _ = env.reset(seed=start)
    score, steps, ended = 0.0, 0, False
    while not ended:
        action = policy.act(adapter.obs(observation), steps, rng)
        observation, reward, terminated, truncated, _ = env.step(adapter.to_env(action))
        score, steps = score + float(reward), steps + 1
        ended = terminated or truncated
    return score, steps
