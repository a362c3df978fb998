"""Slots: the paper's W workers, each with its environments and its random streams.

A process steps all its slots side by side. Nothing here depends on which process that is or which
slots lie beside each other: every matrix product is done slot by slot, in shapes of its own, and
everything else is element by element.

Shape letters: T steps · S slots · E environments of a slot · n = S E rows · O observation size.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from safetensors.numpy import load, save

from dppo.config import Config
from dppo.distributions import Distribution
from dppo.moments import Moments
from dppo.networks import Networks, through
from dppo.normalizer import ObsNormalizer, Statistics, with_clock
from dppo.rollout import Replay, Rollout
from dppo.schedules import scheduled_gamma
from dppo.streams import stream
from workers.episodes import Episodes, Row, Step
from workers.snapshots import packed, unpacked

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
_REPLAYED = ("obs", "v_target", "sigma_target")


@dataclass(frozen=True, slots=True)
class Facts:
    """What the learner is told of a rollout, besides the estimates."""

    obs: Moments
    returns: Moments
    reward: Moments
    episodes: Float64  # [2 k] return and length of each finished episode


class Slots:
    """Some slots of a run, all at the start of the same iteration."""

    def __init__(self, indices: Sequence[int], config: Config, iteration: int) -> None:
        """Environments without an episode yet: see `fresh` and `restored`."""
        self.indices, self.config, self.iteration = tuple(indices), config, iteration
        self._envs = config.rollout.num_envs
        self.environments = Episodes(
            config, [Row(slot, index) for slot in self.indices for index in range(self._envs)]
        )
        self.replays: dict[int, Replay] = {}
        """Of each slot, the previous iteration's critic samples, if they are used again."""

    @classmethod
    def fresh(cls, indices: Sequence[int], config: Config) -> "Slots":
        """Slots at the start of the run: every environment at its first episode."""
        slots = cls(indices, config, 0)
        slots.environments.begin()
        return slots

    @classmethod
    def restored(
        cls, indices: Sequence[int], config: Config, iteration: int, snapshots: Sequence[bytes]
    ) -> "Slots":
        """Slots as they were when their snapshots were taken."""
        slots = cls(indices, config, iteration)
        states = []
        for slot, snapshot in zip(slots.indices, snapshots, strict=True):
            arrays = load(snapshot)
            states += unpacked(arrays, slots._envs)
            if config.update.critic_replay and "replay/obs" in arrays:
                slots.replays[slot] = Replay(
                    **{name: arrays[f"replay/{name}"] for name in _REPLAYED}
                )
        slots.environments.restore(states)
        return slots

    def snapshot(self, slot: int) -> bytes:
        """One slot between two iterations, as safetensors."""
        arrays = packed([self.environments.capture(row) for row in self._rows(slot)])
        if replay := self.replays.get(slot):
            arrays |= {f"replay/{name}": getattr(replay, name) for name in _REPLAYED}
        return save(arrays)

    def is_exact(self, slot: int) -> bool:
        """No environment of the slot has lost a bit on a move."""
        return all(self.environments.is_exact(row) for row in self._rows(slot))

    def close(self) -> None:
        """Close the environments."""
        self.environments.close()

    def _rows(self, slot: int) -> range:
        first = self.indices.index(slot) * self._envs
        return range(first, first + self._envs)

    def collect(
        self,
        networks: Networks,
        distribution: Distribution,
        parameters: Float32,
        statistics: Statistics,
    ) -> list[tuple[Rollout, Facts]]:
        """Run the policy for T steps in every environment (Algorithm 3: the K-step windows).

        Returns:
            Of each slot, in the order of `indices`, the rollout [T, E] and the facts.

        Raises:
            EnvironmentFailedError: an environment raised or returned what is not finite.
        """
        record = _Record(self.config, self.environments)
        self.environments.gamma = scheduled_gamma(self.config, self.iteration)
        normalizer = statistics.obs_normalizer(self.config.rollout)
        vector, log_std = networks.split_policy(parameters)
        policy = networks.policy.layers(vector)
        noise = distribution.scaled(self._noise(distribution), log_std)
        for t in range(self.config.rollout.num_steps):
            seen = record.seen(normalizer, self.environments.obs, self.environments.steps)
            output = through(policy, seen.reshape(len(self.indices), self._envs, -1))
            action = distribution.sample(output.reshape(len(seen), -1), noise[t])
            record.before(t, action)
            record.after(t, self.environments.step(action))
        self.iteration += 1
        rows = [slice(k * self._envs, (k + 1) * self._envs) for k in range(len(self.indices))]
        return record.results(normalizer, rows)

    def _noise(self, distribution: Distribution) -> Float32:
        """[T, n, ...] draws of all slots, each from its own stream."""
        settings, iteration = self.config, self.iteration
        shape = (settings.rollout.num_steps, self._envs)
        draws = [
            distribution.noise(stream(settings.run.seed, "action", slot, iteration), shape)
            for slot in self.indices
        ]
        return np.concatenate(draws, axis=1)


class _Record:
    """The arrays of one rollout while it is made."""

    def __init__(self, config: Config, environments: Episodes) -> None:
        self._config, self._environments = config, environments
        shape = (config.rollout.num_steps, len(environments.obs))
        adapter = environments.adapter
        self.obs = np.empty((*shape, adapter.obs_size))
        self.next_obs = np.empty((*shape, adapter.obs_size))
        self.clock = np.empty(shape)  # steps since the episode's start
        self.action = np.empty((*shape, adapter.action_size), np.float32)
        self.reward = np.empty(shape)
        self.discounted = np.empty(shape)
        self.terminated = np.zeros(shape, np.bool_)
        self.truncated = np.zeros(shape, np.bool_)
        self.episodes: list[tuple[int, float, float]] = []  # row, return and length, as they end

    def before(self, t: int, action: Float32) -> None:
        """Note s_t and a_t."""
        self.obs[t] = self._environments.obs
        self.clock[t] = self._environments.steps
        self.action[t] = action

    def after(self, t: int, step: Step) -> None:
        """Note r_t and s_{t+1}; begin anew after an end."""
        environments = self._environments
        self.next_obs[t] = step.next_obs
        self.reward[t] = step.reward
        self.discounted[t] = environments.discounted
        ended = step.terminated | step.truncated
        if np.count_nonzero(ended):  # a fifth of the time of `any`
            self.terminated[t] = step.terminated
            self.truncated[t] = step.truncated & ~step.terminated
            for row in np.flatnonzero(ended):
                facts = float(environments.score[row]), float(environments.steps[row])
                self.episodes.append((int(row), *facts))
            environments.begin(ended)

    def seen(self, normalizer: ObsNormalizer, obs: Float64, clock: NDArray[np.number]) -> Float32:
        """What the networks see: normalised, with the time feature behind if asked for."""
        normalized = normalizer(obs)
        has_clock = self._config.rollout.time_limit == "time-feature"
        return with_clock(normalized, clock) if has_clock else normalized

    def results(
        self, normalizer: ObsNormalizer, slots: Sequence[slice]
    ) -> list[tuple[Rollout, Facts]]:
        """Rollout and facts of each slot's rows, as the learner's mathematics wants them."""
        ended = self.terminated | self.truncated
        window = self._config.rollout.window or len(ended)
        ended[window - 1 :: window] = True  # the window is cut: bootstrapped, not over
        zero_past = self.terminated
        if self._config.rollout.time_limit == "time-feature":
            zero_past = self.terminated | self.truncated
        obs = self.seen(normalizer, self.obs, self.clock)
        next_obs = self.seen(normalizer, self.next_obs, self.clock + 1)
        return [
            (
                Rollout(
                    obs=obs[:, rows],
                    next_obs=next_obs[:, rows],
                    action=self.action[:, rows],
                    reward=self.reward[:, rows],
                    terminated=zero_past[:, rows],
                    ended=ended[:, rows],
                    starts=self.clock[:, rows] == 0,
                ),
                self._facts(rows),
            )
            for rows in slots
        ]

    def _facts(self, rows: slice) -> Facts:
        """What the learner is told of one slot."""
        return Facts(
            obs=Moments.of(self.obs[:, rows].reshape(-1, self.obs.shape[-1])),
            returns=Moments.of(self.discounted[:, rows].ravel()),
            reward=Moments.of(self.reward[:, rows].ravel()),
            episodes=np.array(
                [
                    fact
                    for row, *facts in self.episodes
                    if rows.start <= row < rows.stop
                    for fact in facts
                ]
            ),
        )
