"""A real run, with everything that its messages carry, and its raw experience.

The run goes through the chief, the exchange, a worker's whole life and its slots.
"""

import json
import threading
from dataclasses import dataclass
from typing import Any

import numpy as np

from dppo.config import (
    Config,
    KlConfig,
    NetworkConfig,
    ReturnsConfig,
    RolloutConfig,
    RunConfig,
    SafetyConfig,
    UpdateConfig,
)
from dppo.distributions import distribution_of
from dppo.leases import Leases
from dppo.moments import Moments
from dppo.networks import Networks
from dppo.normalizer import Statistics
from dppo.rollout import Rollout
from dppo.spaces import Spaces
from dppo.wire.memory_links import MemoryHub, MemoryLearnerLink
from dppo.wire.messages import Collect, Gradient, Measure, Update, Welcome
from learner.chief import Chief
from learner.exchange import Exchange
from learner.ledger import Ledger
from learner.report import IterationReport
from learner.soundness import Expected
from learner.state import State
from workers.membership import Member
from workers.slots import Slots

ITERATIONS, SLOTS, ENVS, STEPS, WINDOW, UPDATES = 4, 4, 2, 64, 32, 4
TRAINED = range(1, ITERATIONS)
"""Iterations with updates; the first one only fills the shared statistics."""
HIDDEN = (16, 16)
XI, PSI = 50.0, 0.1
GAMMA, LAMBDA = 0.98, 0.9
RATE, STD_RATE, CRITIC_RATE, MAX_NORM, EPS = 1e-2, 3.0, 1e-3, 0.5, 1e-5
"""Learning rates: of the policy, of log std as a factor of that, of the critics."""

# Short time limits, so that there are truncations beside terminations; windows are cut at 32 and
# 64. KL targets low enough that the hinge of the objective acts.
CASES: dict[str, Any] = {
    "Hopper-v5": ({"max_episode_steps": 13}, "gae", 1.0, 5e-4),
    "CartPole-v1": ({"max_episode_steps": 17}, "monte-carlo", -1.0, 5e-5),
}


def config_of(env):
    env_kwargs, targets, lambda_ret, kl_target = CASES[env]
    return Config(
        run=RunConfig(
            env=env,
            env_kwargs=json.dumps(env_kwargs),
            seed=5,
            total_timesteps=ITERATIONS * SLOTS * ENVS * STEPS,
        ),
        rollout=RolloutConfig(slots=SLOTS, num_envs=ENVS, num_steps=STEPS, window=WINDOW),
        returns=ReturnsConfig(
            gamma=GAMMA, gae_lambda=LAMBDA, lambda_ret=lambda_ret, targets=targets
        ),
        safety=SafetyConfig(psi=PSI),
        update=UpdateConfig(
            learning_rate=RATE,
            critic_learning_rate=CRITIC_RATE,
            update_epochs=2,
            num_minibatches=2,
        ),
        kl=KlConfig(kl_target=kl_target, kl_stop=1e6),
        network=NetworkConfig(hidden_sizes=HIDDEN, log_std_init=-0.5, log_std_rate=STD_RATE),
    )


class _Recorder(MemoryLearnerLink):
    """A learner's end that remembers what went past."""

    def __init__(self, link):
        super().__init__(link._inbox, link._workers)
        self.sent, self.received = [], []

    def send(self, worker, message):
        self.sent.append(message)
        super().send(worker, message)

    def receive(self, timeout):
        message = super().receive(timeout)
        self.received.append(message)
        return message


@dataclass
class Iteration:
    """One iteration of the run: what was asked, what came back, and the raw experience."""

    asked: list[Any]
    """every message to the worker"""
    answered: list[Any]
    """every message from the worker"""
    collect: Collect
    updates: list[Update]
    gradients: list[list[Gradient]]
    """of each update"""
    parameters: list[np.ndarray]
    """before each update, and after the last; without updates those of the collection"""
    rollouts: list[Rollout]

    @property
    def statistics(self):
        """What the worker was told of the iterations before."""
        return Statistics(
            Moments.from_vector(self.collect.obs),
            Moments.from_vector(self.collect.returns),
            Moments.from_vector(self.collect.sigma_target),
        )


@dataclass
class Run:
    config: Config
    spaces: Spaces
    networks: Networks
    iterations: list[Iteration]
    end: State
    """after the last iteration"""


@dataclass
class Trained:
    """A run and everything that went over its link."""

    link: _Recorder
    spaces: Spaces
    networks: Networks
    end: State
    reports: list[IterationReport]


def train(config):
    """Run the chief over a memory link, with one worker in a thread."""
    hub = MemoryHub()
    link = _Recorder(hub.learner())
    welcome = Welcome(run="golden", generation=1, config=json.dumps(config.to_dict()))
    exchange = Exchange(link, welcome, Leases(SLOTS), lambda: None)
    member = Member("w0", hub.worker("w0"), 60.0)
    thread = threading.Thread(target=member.live, daemon=True)
    thread.start()
    spaces = exchange.wait_for_environment()
    networks = Networks.build(spaces, config)
    exchange.expected = Expected(spaces, networks.size, ENVS * STEPS)
    state = State.initial(networks, spaces.obs_size, config)
    chief = Chief(state, networks, config, 1, exchange, Ledger(config.rollout, lambda _: None))
    reports = [chief.iterate().report() for _ in range(ITERATIONS)]
    exchange.stop("the run is finished", final=True)
    thread.join(60.0)
    return Trained(link, spaces, networks, chief.state, reports)


def record(config):
    trained = train(config)
    link, spaces, networks = trained.link, trained.spaces, trained.networks
    slots = Slots.fresh(range(SLOTS), config)
    iterations = []
    for number in range(ITERATIONS):
        asked, answered = (
            [m for m in messages if getattr(m, "iteration", -1) == number]
            for messages in (link.sent, link.received)
        )
        collect = next(m for m in asked if isinstance(m, Collect))
        updates = [m for m in asked if isinstance(m, Update)]
        measured = [m.parameters for m in asked if isinstance(m, Measure)]
        gradients = [m for m in answered if isinstance(m, Gradient)]
        iterations.append(
            Iteration(
                asked,
                answered,
                collect,
                updates,
                [[g for g in gradients if g.round == u.round] for u in updates],
                [u.parameters for u in updates] + measured or [collect.parameters],
                [],
            )
        )
        # collecting is a function of (seed, slot, iteration): the same steps as the worker's
        collected = slots.collect(
            networks,
            distribution_of(spaces),
            collect.parameters,
            iterations[-1].statistics,
        )
        iterations[-1].rollouts += [rollout for rollout, _ in collected]
    slots.close()
    return Run(config, spaces, networks, iterations, trained.end)
