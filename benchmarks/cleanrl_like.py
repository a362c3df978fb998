"""PPO with the settings of CleanRL's `ppo_continuous_action`, in our own words.

The published package (0.4.8) cannot run with a current gymnasium, see README.md; its settings can:
separate 64x64 tanh networks for policy and value, observations and rewards normalised by running
statistics and cut at 10, γ .99, λ .95, ratio clip .2 for policy and value, value weight .5, Adam
3e-4 with a linear decay, gradient norm .5, advantages standardised per minibatch.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium import wrappers
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.distributions import Normal

GAMMA, TRACE, CLIP, RATE = 0.99, 0.95, 0.2, 3e-4


@dataclass(frozen=True, kw_only=True)
class Settings:
    """What differs between the cases."""

    num_envs: int
    num_steps: int
    minibatches: int
    epochs: int = 10
    backend: str = "sync"
    """sync: gymnasium's SyncVectorEnv; envpool: EnvPool's synchronous mode."""

    @property
    def batch(self) -> int:
        """Samples of one iteration."""
        return self.num_envs * self.num_steps


class Agent(nn.Module):
    """Two networks and a state-independent spread."""

    def __init__(self, obs_size: int, action_size: int) -> None:
        super().__init__()
        self.policy, self.value = _mlp(obs_size, action_size, 0.01), _mlp(obs_size, 1, 1.0)
        self.log_std = nn.Parameter(torch.zeros(1, action_size))

    def distribution(self, obs: Tensor) -> Normal:
        """Of the actions."""
        return Normal(self.policy(obs), self.log_std.exp(), validate_args=False)


def _mlp(size: int, outputs: int, gain: float) -> nn.Sequential:
    sizes, layers = (size, 64, 64), list[nn.Module]()
    for inputs, width in pairwise(sizes):
        layers += [_linear(inputs, width, 2**0.5), nn.Tanh()]
    return nn.Sequential(*layers, _linear(64, outputs, gain))


def _linear(inputs: int, outputs: int, gain: float) -> nn.Linear:
    layer = nn.Linear(inputs, outputs)
    nn.init.orthogonal_(layer.weight, gain)
    nn.init.zeros_(layer.bias)
    return layer


class Scaler:
    """Running statistics of observations and discounted returns, over all environments at once."""

    def __init__(self, envs: Any, low: NDArray[Any], high: NDArray[Any]) -> None:  # noqa: ANN401
        self._envs, self._low, self._high = envs, low, high
        self._obs: list[Any] = [1e-4, 0.0, 1.0]
        self._gain: list[Any] = [1e-4, 0.0, 1.0]
        self._returns: Any = 0.0

    def reset(self) -> NDArray[Any]:
        """First observations."""
        return self._scaled(self._envs.reset()[0])

    def step(self, action: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
        """Observations, rewards, ends."""
        obs, reward, terminated, truncated, _ = self._envs.step(
            np.clip(action, self._low, self._high)
        )
        ended = terminated | truncated
        self._returns = self._returns * GAMMA + reward
        _merge(self._gain, self._returns)
        self._returns = self._returns * ~ended
        scaled = reward / np.sqrt(self._gain[2] + 1e-8)
        return self._scaled(obs), np.clip(scaled, -10, 10), ended

    def _scaled(self, obs: NDArray[Any]) -> NDArray[Any]:
        _merge(self._obs, obs)
        scaled = (obs - self._obs[1]) / np.sqrt(self._obs[2] + 1e-8)
        return np.asarray(np.clip(scaled, -10, 10))


def _merge(moments: list[Any], rows: NDArray[Any]) -> None:
    """Count, mean and variance with the rows added."""
    count, mean, var = moments
    n, shift, total = len(rows), rows.mean(axis=0) - mean, count + len(rows)
    spread = var * count + rows.var(axis=0) * n + shift**2 * count * n / total
    moments[:] = [total, mean + shift * n / total, spread / total]


class Wrapped:
    """The same through gymnasium's wrappers, one environment at a time, as CleanRL has it."""

    def __init__(self, env_id: str, num_envs: int) -> None:
        self.envs = gymnasium.vector.SyncVectorEnv([lambda: _wrapped(env_id)] * num_envs)

    def reset(self) -> NDArray[Any]:
        """First observations."""
        return np.asarray(self.envs.reset(seed=1)[0])

    def step(self, action: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
        """Observations, rewards, ends."""
        obs, reward, terminated, truncated, _ = self.envs.step(action)
        return obs, reward, terminated | truncated


def _wrapped(env_id: str) -> gymnasium.Env[Any, Any]:
    env: Any = wrappers.FlattenObservation(gymnasium.make(env_id))
    env = wrappers.RecordEpisodeStatistics(env)
    env = wrappers.NormalizeObservation(wrappers.ClipAction(env))
    env = wrappers.TransformObservation(
        env, lambda obs: np.clip(obs, -10, 10), env.observation_space
    )
    env = wrappers.NormalizeReward(env, gamma=GAMMA)
    return wrappers.TransformReward(env, lambda reward: min(max(float(reward), -10.0), 10.0))


def train(env_id: str, settings: Settings, note: Callable[[int], None]) -> None:
    """Train until the process is ended; `note` is told the steps at each iteration's end."""
    envs: Any = Wrapped(env_id, settings.num_envs)
    spaces = envs.envs.single_observation_space, envs.envs.single_action_space
    if settings.backend == "envpool":
        import envpool

        made = envpool.make(env_id, env_type="gymnasium", num_envs=settings.num_envs, seed=1)
        envs = Scaler(made, spaces[1].low, spaces[1].high)
    agent = Agent(*(space.shape[0] for space in spaces))
    optimizer = torch.optim.Adam(agent.parameters(), lr=RATE, eps=1e-5)
    obs, ended = torch.as_tensor(envs.reset(), dtype=torch.float32), torch.zeros(settings.num_envs)
    steps, iterations = 0, 10_000_000 // settings.batch
    note(0)
    for iteration in range(iterations):
        optimizer.param_groups[0]["lr"] = RATE * (1 - iteration / iterations)
        batch, obs, ended = _rollout(agent, envs, obs, ended, settings.num_steps)
        _learn(agent, optimizer, batch, settings)
        steps += settings.batch
        note(steps)


@torch.no_grad()
def _rollout(
    agent: Agent,
    envs: Any,  # noqa: ANN401
    obs: Tensor,
    ended: Tensor,
    num_steps: int,
) -> tuple[list[Tensor], Tensor, Tensor]:
    """[T, n] of everything; observations and ends that come next."""
    columns: list[list[Tensor]] = [[] for _ in range(6)]
    for _ in range(num_steps):
        pi, value = agent.distribution(obs), agent.value(obs)[:, 0]
        action = pi.sample()
        row = (obs, action, pi.log_prob(action).sum(1), value, ended)
        next_obs, reward, over = envs.step(action.numpy())
        for column, part in zip(columns, (*row, torch.as_tensor(reward)), strict=True):
            column.append(part)
        obs, ended = torch.as_tensor(next_obs, dtype=torch.float32), torch.as_tensor(over).float()
    obs_, action_, log_prob, value_, ended_, reward_ = (torch.stack(c) for c in columns)
    advantage, trace = torch.zeros_like(value_), torch.zeros_like(ended)
    follower, alive = agent.value(obs)[:, 0], 1 - ended
    for t in reversed(range(num_steps)):
        delta = reward_[t].float() + GAMMA * follower * alive - value_[t]
        trace = delta + GAMMA * TRACE * alive * trace
        advantage[t], follower, alive = trace, value_[t], 1 - ended_[t]
    parts = (obs_, action_, log_prob, value_, advantage, advantage + value_)
    return [part.flatten(0, 1) for part in parts], obs, ended


def _learn(
    agent: Agent, optimizer: torch.optim.Adam, batch: list[Tensor], settings: Settings
) -> None:
    """`epochs` passes over the batch, each in `minibatches` slices."""
    for _ in range(settings.epochs):
        for rows in torch.randperm(settings.batch).chunk(settings.minibatches):
            obs, action, log_prob, value, advantage, target = (part[rows] for part in batch)
            pi, now = agent.distribution(obs), agent.value(obs)[:, 0]
            ratio = (pi.log_prob(action).sum(1) - log_prob).exp()
            gain = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
            policy_loss = -torch.min(gain * ratio, gain * ratio.clamp(1 - CLIP, 1 + CLIP)).mean()
            bounded = value + (now - value).clamp(-CLIP, CLIP)
            value_loss = torch.max((now - target) ** 2, (bounded - target) ** 2).mean() / 2
            optimizer.zero_grad()
            (policy_loss + 0.5 * value_loss).backward()
            nn.utils.clip_grad_norm_(agent.parameters(), 0.5)
            optimizer.step()
