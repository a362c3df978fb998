"""Algorithm 1 for many trials at once, against the same written for one trial, step by step."""

import re
from dataclasses import replace

import numpy as np
import pytest

from dppo.four_rooms.agent import Outcome, Progress, Trial, learn
from dppo.four_rooms.draws import BLOCK, draw
from dppo.four_rooms.processes import learn_on_cores
from dppo.four_rooms.settings import AgentConfig
from dppo.four_rooms.world import World, WorldConfig

WORLD = World()
SAFE, PLAIN = AgentConfig(), AgentConfig(psi=0.0, alpha_critic=0.1)
EPISODES, SEED = 12, 3
BAR = (0.99 * 0.99) ** 2  # γ̄ of all agents here


def outcomes(trials, episodes=EPISODES, world=WORLD):
    """The finished trials by agent and number."""
    found = (
        event
        for event in learn(world, trials, episodes=episodes, seed=SEED)
        if isinstance(event, Outcome)
    )
    return {(one.trial.agent, one.trial.number): one for one in found}


def same_bits(one, other):
    names = ("policy", "q", "sigma", "returns", "lengths", "frozen")
    return all(getattr(one, name).tobytes() == getattr(other, name).tobytes() for name in names)


@pytest.mark.slow
def test_a_trial_gives_the_same_numbers_alone_among_10_and_among_50():
    alone = outcomes([Trial(SAFE, 4)])[SAFE, 4]
    among_10 = outcomes([Trial(SAFE, number) for number in range(10)])[SAFE, 4]
    others = [replace(SAFE, update="printed"), replace(SAFE, baseline=True, occupancy=True), PLAIN]
    mixed = [Trial(agent, number) for number in range(12) for agent in (*others, SAFE)]
    among_50 = outcomes([*mixed, Trial(PLAIN, 40), Trial(PLAIN, 41)])[SAFE, 4]
    assert same_bits(alone, among_10)
    assert same_bits(alone, among_50)


@pytest.mark.slow
def test_processes_give_the_same_numbers_as_one_process():
    trials = [Trial(agent, number) for agent in (PLAIN, SAFE) for number in range(5)]
    here = outcomes(trials)
    events = list(learn_on_cores(WorldConfig(), trials, episodes=EPISODES, seed=SEED, jobs=3))
    there = [event for event in events if isinstance(event, Outcome)]
    assert len(there) == len(trials)
    assert all(same_bits(here[one.trial.agent, one.trial.number], one) for one in there)
    passed = sum(event.episodes for event in events if isinstance(event, Progress))
    assert passed == len(trials) * EPISODES


def test_other_seeds_and_trials_give_other_numbers():
    found = outcomes([Trial(SAFE, 0), Trial(SAFE, 1)])
    assert not same_bits(found[SAFE, 0], found[SAFE, 1])


def bootstrap(update, q, sigma, then, pi):
    """What is expected after this step, from the next state's rows."""
    match update:
        case "printed":
            return q.max(), sigma.min()
        case "expected":
            return pi @ q, pi @ sigma
    return q[then], sigma[then]


def by_hand(agent, number, world):
    """Algorithm 1 for one trial, one step after the other: θ, Q, σ and the returns."""
    theta, q = np.full((2, world.states, 4), 0.5)
    sigma = np.zeros((world.states, 4))
    returns: list[float] = []
    clock = row = 0
    draws = draw(world, SEED, "begin", [number], 0)

    def pi(state):
        e = np.exp((theta[state] - theta[state].max()) / agent.temperature)
        return e / e.sum()

    def pick(state, uniform):
        return int((uniform >= np.cumsum(pi(state))[:3]).sum())

    def begin():
        state = draws.start[row, 0]
        return state, pick(state, draws.first_action[row, 0]), 0.0, 0

    state, action, total, steps = begin()
    while len(returns) < EPISODES:
        row = clock % BLOCK
        draws = draw(world, SEED, "learn", [number], clock // BLOCK) if row == 0 else draws
        slot = draws.slot[row, 0]
        after = int(world.successor[state, action, slot])
        over = after == world.goal
        reward = 50.0 * over + draws.noise[row, 0] * world.noisy[state, action, slot]
        then = pick(after, draws.action[row, 0])
        next_q, next_sigma = bootstrap(agent.update, q[after], sigma[after], then, pi(after))
        delta = reward + (0 if over else agent.gamma * next_q) - q[state, action]
        delta_sigma = delta**2 + (0 if over else BAR * next_sigma) - sigma[state, action]
        q[state, action] += agent.alpha_critic * delta
        sigma[state, action] += agent.alpha_sigma * delta_sigma
        psi = agent.psi_at(len(returns) / EPISODES)
        weight, weight_bar = (agent.gamma**steps, BAR**steps) if agent.occupancy else (1.0, 1.0)
        worth = weight * q[state] - psi * weight_bar * sigma[state]
        gain = worth[action] - (pi(state) @ worth if agent.baseline else 0.0)
        gain /= agent.temperature if agent.inverse_temperature else 1.0
        theta[state] += agent.alpha_theta * gain * (np.eye(4)[action] - pi(state))
        total += agent.gamma**steps * reward
        state, action, steps, clock = after, then, steps + 1, clock + 1
        if over or steps == 500:
            returns.append(total)
            state, action, total, steps = begin()
    return np.array([pi(cell) for cell in range(world.states)]), q, sigma, returns


@pytest.mark.parametrize(
    "change",
    [
        {}, {"update": "printed"}, {"update": "expected"}, {"baseline": True},
        {"occupancy": True}, {"occupancy": True, "baseline": True},
        {"inverse_temperature": True, "alpha_theta": 0.001},
        {"psi_schedule": "linear"}, {"psi_schedule": "warmup", "psi_warmup": 0.5},
    ],
    ids=str,
)  # fmt: skip
def test_it_is_algorithm_1(change):
    agent = replace(SAFE, **change)
    found = outcomes([Trial(agent, 0)])[agent, 0]
    policy, q, sigma, returns = by_hand(agent, 0, WORLD)
    assert found.returns == pytest.approx(returns, rel=1e-9)
    assert found.q == pytest.approx(q, rel=1e-9)
    assert found.sigma == pytest.approx(sigma, rel=1e-9)
    assert found.policy == pytest.approx(policy, rel=1e-6, abs=1e-9)


def test_the_same_holds_in_the_variants_of_the_world():
    world = World(WorldConfig(slip_to="actions", noise="normal", paid="leaving"))
    found = outcomes([Trial(SAFE, 0)], world=world)[SAFE, 0]
    _, q, _, returns = by_hand(SAFE, 0, world)
    assert found.returns == pytest.approx(returns, rel=1e-9)
    assert found.q == pytest.approx(q, rel=1e-9)


def test_episodes_are_counted_whole():
    found = outcomes([Trial(SAFE, 0)])[SAFE, 0]
    assert found.returns.shape == found.lengths.shape == found.frozen.shape == (EPISODES,)
    assert (found.lengths >= 1).all()
    assert (found.lengths <= 500).all()
    assert (found.frozen <= found.lengths).all()


def test_psi_is_constant_or_grows_over_the_episodes():
    linear = replace(SAFE, psi_schedule="linear")
    warm = replace(SAFE, psi_schedule="warmup", psi_warmup=0.5)
    assert [SAFE.psi_at(progress) for progress in (0.0, 0.5, 1.0)] == [0.25] * 3
    assert [linear.psi_at(progress) for progress in (0.0, 0.5, 1.0)] == [0.0, 0.125, 0.25]
    assert [warm.psi_at(progress) for progress in (0.0, 0.5, 0.75)] == [0.0, 0.0, 0.125]


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"psi": float("inf")}, "--psi is inf, expected a finite number"),
        ({"psi": -0.1}, "--psi is -0.1, expected >= 0"),
        ({"temperature": 0.0}, "--temperature is 0.0, expected > 0"),
        ({"alpha_theta": 0.0}, "--alpha-theta is 0.0, expected > 0"),
        ({"alpha_critic": 1.5}, "--alpha-critic is 1.5, expected 0 < rate <= 1"),
        ({"alpha_sigma": 0.0}, "--alpha-sigma is 0.0, expected 0 < rate <= 1"),
        ({"gamma": 1.01}, "--gamma is 1.01, expected 0 .. 1"),
        ({"psi_warmup": 1.0}, "--psi-warmup is 1.0, expected 0 <= psi_warmup < 1"),
    ],
)
def test_settings_that_cannot_learn_are_refused(settings, sentence):
    with pytest.raises(ValueError, match=re.escape(sentence)):
        AgentConfig(**settings)
