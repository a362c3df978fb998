"""Algorithm 1 of Safe Actor-Critic, for many trials at once.

All trials take their n-th step together. None waits: a trial whose episode ends begins its next
one at once. Trials may belong to different agents.

Tables are action-major, so that a loop over actions is a loop over rows:
B trials, S cells, A actions; a table is [A, B S], and the cell of trial b is column b S + s.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dppo.four_rooms.draws import BLOCK, Draws, draw
from dppo.four_rooms.mdp import Floats
from dppo.four_rooms.settings import AgentConfig
from dppo.four_rooms.world import ACTIONS, GOAL_REWARD, MAX_STEPS, SLOTS, Ints, World

_FIRST_Q, _FIRST_THETA, _FIRST_SIGMA = 0.5, 0.5, 0.0
_A = len(ACTIONS)


@dataclass(frozen=True, slots=True)
class Trial:
    """One agent with one stream of random numbers."""

    agent: AgentConfig
    number: int


@dataclass(frozen=True, slots=True)
class Outcome:
    """What one trial learned, and what it went through. E episodes."""

    trial: Trial
    policy: Floats  # [S, A]  π after the last episode
    q: Floats  # [S, A]
    sigma: Floats  # [S, A]
    returns: Floats  # [E]  discounted
    lengths: NDArray[np.int16]  # [E]  steps
    frozen: NDArray[np.int16]  # [E]  steps that ended on a frozen cell


@dataclass(frozen=True, slots=True)
class Progress:
    """How far all trials are: episodes since the last report."""

    episodes: int


def learn(
    world: World, trials: Sequence[Trial], *, episodes: int, seed: int
) -> Iterator[Outcome | Progress]:
    """Run the trials; each comes out as soon as it has finished."""
    batch = _Batch(world, trials, episodes)
    batch.begin(np.arange(len(trials)), draw(world, seed, "begin", batch.numbers, 0), 0)
    block = 0
    while batch.trials:
        before = int(np.minimum(batch.episode, episodes).sum())
        draws = draw(world, seed, "learn", batch.numbers, block)
        for step in range(BLOCK):
            batch.step(draws, step)
        yield Progress(int(np.minimum(batch.episode, episodes).sum()) - before)
        yield from batch.outcomes
        batch.drop_finished()
        block += 1


class _Batch:
    """The present of all trials that are not finished."""

    def __init__(self, world: World, trials: Sequence[Trial], episodes: int) -> None:
        self.trials = list(trials)
        self.outcomes: list[Outcome] = []
        self._world, self._episodes = world, episodes
        self._successor = world.successor.reshape(-1)
        self._noisy = world.noisy.reshape(-1).astype(np.float64)
        cells = len(trials) * world.states
        self._theta = np.full((_A, cells), _FIRST_THETA)
        self._policy = np.full((_A, cells), 1 / _A)
        self._q = np.full((_A, cells), _FIRST_Q)
        self._sigma = np.full((_A, cells), _FIRST_SIGMA)
        self.episode = np.zeros(len(trials), np.intp)
        self._state, self._action = np.zeros((2, len(trials)), np.intp)
        self._steps, self._frozen = np.zeros((2, len(trials)), np.intp)
        self._return, self._discount, self._weight_q, self._weight_sigma = np.ones(
            (4, len(trials))
        )
        # one column more than there are episodes: what a trial does past its last one
        self._returns = np.zeros((len(trials), episodes + 1))
        self._lengths, self._frozens = np.zeros((2, len(trials), episodes + 1), np.int16)
        self._read_settings()

    @property
    def numbers(self) -> list[int]:
        """The trials' numbers, which choose their streams."""
        return [trial.number for trial in self.trials]

    def _read_settings(self) -> None:
        """Each trial's settings as arrays [B]."""
        agents = [trial.agent for trial in self.trials]

        def column(name: str) -> Floats:
            return np.array([getattr(agent, name) for agent in agents], np.float64)

        self._gamma, self._gamma_bar = column("gamma"), column("variance_discount")
        self._alpha_critic, self._alpha_sigma = column("alpha_critic"), column("alpha_sigma")
        self._actor_step, self._temperature = column("actor_step"), column("temperature")
        updates = np.array([agent.update for agent in agents])
        self._printed = np.flatnonzero(updates == "printed")
        self._expected = np.flatnonzero(updates == "expected")
        self._with_baseline = np.flatnonzero([agent.baseline for agent in agents])
        self._with_occupancy = np.flatnonzero([agent.occupancy for agent in agents])
        self._base = np.arange(len(agents)) * self._world.states
        self._rows = np.arange(_A)[:, None] * (len(agents) * self._world.states)
        self._place = np.arange(len(agents))

    def begin(self, places: Ints, draws: Draws, step: int) -> None:
        """The trials at `places` begin their next episode."""
        self._state[places] = draws.start[step, places]
        policy = self._policy[:, self._base[places] + self._state[places]]
        self._action[places] = _choose(policy, draws.first_action[step, places])
        self._steps[places] = 0
        self._frozen[places] = 0
        self._return[places] = 0.0
        self._discount[places] = 1.0
        self._weight_q[places] = 1.0
        self._weight_sigma[places] = [
            self.trials[place].agent.psi_at(self.episode[place] / self._episodes)
            for place in places
        ]

    def step(self, draws: Draws, step: int) -> None:
        """One step of every trial: move, learn, and begin anew where an episode has ended."""
        move = (self._state * _A + self._action) * SLOTS + draws.slot[step]
        next_state = self._successor[move]
        terminated = next_state == self._world.goal
        reward = self._noisy[move] * draws.noise[step] + GOAL_REWARD * terminated
        next_policy = self._policy.take(self._rows + (self._base + next_state))
        next_action = _choose(next_policy, draws.action[step])

        self._learn(reward, terminated, next_state, next_action, next_policy)

        self._return += self._discount * reward
        self._discount *= self._gamma
        self._steps += 1
        self._frozen += self._world.frozen[next_state]
        self._state, self._action = next_state, next_action
        ended = np.flatnonzero(terminated | (self._steps == MAX_STEPS))
        if len(ended):
            self._record(ended)
            self.begin(ended, draws, step)

    def _learn(
        self,
        reward: Floats,
        terminated: NDArray[np.bool_],
        next_state: Ints,
        next_action: Ints,
        next_policy: Floats,
    ) -> None:
        """The updates of w, z and θ, in the order of Algorithm 1."""
        cell, next_cell = self._base + self._state, self._base + next_state
        here = self._action * self._theta.shape[1] + cell
        there = next_action * self._theta.shape[1] + next_cell
        q, sigma = self._q.take(here), self._sigma.take(here)
        next_q, next_sigma = self._q.take(there), self._sigma.take(there)
        self._bootstrap_otherwise(next_q, next_sigma, next_cell, next_policy)
        goes_on = 1.0 - terminated

        delta = reward + self._gamma * goes_on * next_q - q
        delta_sigma = delta * delta + self._gamma_bar * goes_on * next_sigma - sigma
        q += self._alpha_critic * delta
        sigma += self._alpha_sigma * delta_sigma
        self._q.put(here, q)
        self._sigma.put(here, sigma)

        row = self._rows + cell
        policy, theta = self._policy.take(row), self._theta.take(row)
        gain = self._weight_q * q - self._weight_sigma * sigma
        self._subtract_baseline(gain, cell, policy)
        gain *= self._actor_step
        theta -= gain * policy  # ∇ log π(a|s) is 1 at a, minus π(·|s)
        theta[self._action, self._place] += gain
        self._theta.put(row, theta)
        self._policy.put(row, _softmax(theta, self._temperature))
        self._decay_weights()

    def _bootstrap_otherwise(
        self, next_q: Floats, next_sigma: Floats, next_cell: Ints, next_policy: Floats
    ) -> None:
        """Max and min, or the policy's mean, instead of the next action's Q and σ."""
        if len(self._printed):
            cells = next_cell[self._printed]
            next_q[self._printed] = self._q[:, cells].max(axis=0)
            next_sigma[self._printed] = self._sigma[:, cells].min(axis=0)
        if len(self._expected):
            cells, policy = next_cell[self._expected], next_policy[:, self._expected]
            next_q[self._expected] = (policy * self._q[:, cells]).sum(axis=0)
            next_sigma[self._expected] = (policy * self._sigma[:, cells]).sum(axis=0)

    def _subtract_baseline(self, gain: Floats, cell: Ints, policy: Floats) -> None:
        """Σ_a π (Q − ψ σ), for the agents that want it."""
        some = self._with_baseline
        if len(some):
            worth = (
                self._weight_q[some] * self._q[:, cell[some]]
                - self._weight_sigma[some] * self._sigma[:, cell[some]]
            )
            gain[some] -= (policy[:, some] * worth).sum(axis=0)

    def _decay_weights(self) -> None:
        """γ^t and γ̄^t, for the agents that weigh by occupancy."""
        some = self._with_occupancy
        if len(some):
            self._weight_q[some] *= self._gamma[some]
            self._weight_sigma[some] *= self._gamma_bar[some]

    def _record(self, ended: Ints) -> None:
        """Keep the episodes that ended; keep the trials that ended with them."""
        episode = np.minimum(self.episode[ended], self._episodes)
        self._returns[ended, episode] = self._return[ended]
        self._lengths[ended, episode] = self._steps[ended]
        self._frozens[ended, episode] = self._frozen[ended]
        self.episode[ended] += 1
        for place in ended[self.episode[ended] == self._episodes]:
            self.outcomes.append(self._outcome(int(place)))

    def _outcome(self, place: int) -> Outcome:
        cells = slice(place * self._world.states, (place + 1) * self._world.states)
        return Outcome(
            trial=self.trials[place],
            policy=self._policy[:, cells].T.copy(),
            q=self._q[:, cells].T.copy(),
            sigma=self._sigma[:, cells].T.copy(),
            returns=self._returns[place, :-1].copy(),
            lengths=self._lengths[place, :-1].copy(),
            frozen=self._frozens[place, :-1].copy(),
        )

    def drop_finished(self) -> None:
        """Go on with the others only."""
        self.outcomes = []
        going = self.episode < self._episodes
        if going.all():
            return
        self.trials = [trial for trial, goes in zip(self.trials, going, strict=True) if goes]
        for name in ("_theta", "_policy", "_q", "_sigma"):
            table = getattr(self, name).reshape(_A, len(going), -1)[:, going]
            setattr(self, name, table.reshape(_A, -1))
        for name in (
            "episode", "_state", "_action", "_steps", "_frozen", "_return", "_discount",
            "_weight_q", "_weight_sigma", "_returns", "_lengths", "_frozens",
        ):  # fmt: skip
            setattr(self, name, getattr(self, name)[going])
        self._read_settings()


def _choose(policy: Floats, uniform: Floats) -> Ints:
    """[B] actions: the first whose cumulated probability [A, B] exceeds the uniform number."""
    cumulated = np.add.accumulate(policy[:-1])
    chosen: Ints = (uniform >= cumulated).sum(axis=0)
    return chosen


def _softmax(theta: Floats, temperature: Floats) -> Floats:
    """[A, B] π = exp(θ / temperature) / Σ exp(θ / temperature)."""
    e = np.exp((theta - theta.max(axis=0)) / temperature)
    policy: Floats = e / e.sum(axis=0)
    return policy
