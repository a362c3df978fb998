"""A slot: one of the paper's W workers, with its environments and its random streams.

Nothing here depends on which process runs the slot or what else that process does.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from safetensors.numpy import load, save

from dppo.config import Config
from dppo.distributions import Distribution
from dppo.moments import Moments
from dppo.networks import Networks
from dppo.normalizer import ObsNormalizer, Statistics
from dppo.rollout import Replay, Rollout
from dppo.streams import stream
from workers.envs import Adapter, exactness, make_env
from workers.episodes import Episodes

Float32 = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Facts:
    """What the learner is told of a rollout, besides the estimates."""

    obs: Moments
    returns: Moments
    episodes: NDArray[np.float64]  # [2 k] return and length of each finished episode


@dataclass(slots=True)
class Slot:
    """One logical worker: E environments that go on from iteration to iteration."""

    index: int
    config: Config
    iteration: int
    """The iteration it will collect next."""
    environments: list[Episodes]
    replay: Replay | None = None

    @classmethod
    def fresh(cls, index: int, config: Config) -> "Slot":
        """The slot at the start of the run: every environment at its first episode."""
        slot = cls._build(index, config, 0)
        for environment in slot.environments:
            environment.begin()
        return slot

    @classmethod
    def restored(cls, index: int, config: Config, iteration: int, snapshot: bytes) -> "Slot":
        """The slot as it was when `snapshot` was taken."""
        slot = cls._build(index, config, iteration)
        arrays = load(snapshot)
        for environment in slot.environments:
            mark = f"{environment.index}/"
            environment.restore(
                {name[len(mark) :]: a for name, a in arrays.items() if name.startswith(mark)}
            )
        if config.update.critic_replay:
            slot.replay = Replay(
                obs=arrays["replay/obs"],
                v_target=arrays["replay/v_target"],
                sigma_target=arrays["replay/sigma_target"],
            )
        return slot

    @classmethod
    def _build(cls, index: int, config: Config, iteration: int) -> "Slot":
        environments = []
        for number in range(config.rollout.num_envs):
            env = make_env(config.run)
            environments.append(
                Episodes(
                    env,
                    Adapter(env.observation_space, env.action_space),
                    exactness(env, config.rollout.exact_envs),
                    config.run.seed,
                    index,
                    number,
                    config.returns.gamma,
                )
            )
        return cls(index, config, iteration, environments)

    def snapshot(self) -> bytes:
        """The slot between two iterations, as safetensors."""
        arrays = {
            f"{environment.index}/{name}": np.ascontiguousarray(array)
            for environment in self.environments
            for name, array in environment.capture().items()
        }
        if self.replay is not None and self.config.update.critic_replay:
            arrays["replay/obs"] = self.replay.obs
            arrays["replay/v_target"] = self.replay.v_target
            arrays["replay/sigma_target"] = self.replay.sigma_target
        return save(arrays)

    @property
    def is_exact(self) -> bool:
        """No environment has lost a bit on a move."""
        return all(environment.is_exact for environment in self.environments)

    def close(self) -> None:
        """Close the environments."""
        for environment in self.environments:
            environment.env.close()

    def collect(
        self,
        networks: Networks,
        distribution: Distribution,
        parameters: Float32,
        statistics: Statistics,
    ) -> tuple[Rollout, Facts]:
        """Run the policy for T steps in every environment (Algorithm 3: the K-step windows).

        Raises:
            EnvironmentFailedError: an environment raised or returned what is not finite.
        """
        record = _Record(self.config, self.environments)
        normalizer = statistics.obs_normalizer(self.config.rollout)
        policy, log_std = networks.split_policy(parameters)
        rng = stream(self.config.run.seed, "action", self.index, self.iteration)
        noise = distribution.noise(rng, record.reward.shape)
        for t in range(self.config.rollout.num_steps):
            record.before(t)
            seen = record.seen(normalizer, record.obs[t], record.clock[t])
            output, _ = networks.policy.forward(policy, seen)
            action = distribution.sample(output, log_std, noise[t])
            record.action[t] = action
            for index in range(len(self.environments)):
                record.step(t, index)
        self.iteration += 1
        return record.rollout(normalizer), record.facts()


class _Record:
    """The arrays of one rollout while it is made."""

    def __init__(self, config: Config, environments: list[Episodes]) -> None:
        self._config, self._environments = config, environments
        shape = (config.rollout.num_steps, len(environments))
        obs_size = len(environments[0].obs)
        action_size = environments[0].adapter.action_size
        self.obs = np.empty((*shape, obs_size))
        self.next_obs = np.empty((*shape, obs_size))
        self.clock = np.empty(shape)  # steps since the episode's start
        self.action = np.empty((*shape, action_size), np.float32)
        self.reward = np.empty(shape)
        self.discounted = np.empty(shape)
        self.terminated = np.zeros(shape, np.bool_)
        self.truncated = np.zeros(shape, np.bool_)
        self.episodes: list[float] = []

    def before(self, t: int) -> None:
        """Note s_t."""
        for index, environment in enumerate(self._environments):
            self.obs[t, index] = environment.obs
            self.clock[t, index] = environment.steps

    def step(self, t: int, index: int) -> None:
        """Step one environment with its action; note r_t and s_{t+1}; begin anew after an end."""
        environment = self._environments[index]
        step = environment.step(self.action[t, index])
        self.next_obs[t, index] = step.next_obs
        self.reward[t, index] = step.reward
        self.discounted[t, index] = environment.discounted
        if step.terminated or step.truncated:
            self.terminated[t, index] = step.terminated
            self.truncated[t, index] = step.truncated and not step.terminated
            self.episodes += [environment.score, float(environment.steps)]
            environment.begin()

    def seen(
        self, normalizer: ObsNormalizer, obs: NDArray[np.float64], clock: NDArray[np.float64]
    ) -> Float32:
        """What the networks see: normalised, with the time feature 0.001 t behind if asked for."""
        normalized = normalizer(obs)
        if self._config.rollout.time_limit == "bootstrap":
            return normalized
        feature = (0.001 * clock[..., None]).astype(np.float32)
        return np.concatenate([normalized, feature], axis=-1)

    def rollout(self, normalizer: ObsNormalizer) -> Rollout:
        """Everything as the learner's mathematics wants it."""
        ended = self.terminated | self.truncated
        window = self._config.rollout.window or len(ended)
        ended[window - 1 :: window] = True  # the window is cut: bootstrapped, not over
        zero_past = self.terminated
        if self._config.rollout.time_limit == "time-feature":
            zero_past = self.terminated | self.truncated
        return Rollout(
            obs=self.seen(normalizer, self.obs, self.clock),
            next_obs=self.seen(normalizer, self.next_obs, self.clock + 1),
            action=self.action,
            reward=self.reward,
            terminated=zero_past,
            ended=ended,
            starts=self.clock == 0,
        )

    def facts(self) -> Facts:
        """What the learner is told."""
        return Facts(
            obs=Moments.of(self.obs.reshape(-1, self.obs.shape[-1])),
            returns=Moments.of(self.discounted.ravel()),
            episodes=np.array(self.episodes),
        )
