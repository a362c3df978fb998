"""Small decision processes for the oracle's tests."""

import numpy as np

from dppo.four_rooms.mdp import Mdp


def random_world(seed, states=4, actions=2):
    """Random ways, rewards and noise; the last state is terminal."""
    rng = np.random.default_rng(seed)
    transition = rng.dirichlet(np.ones(states), (states, actions))
    transition[-1] = 0
    return Mdp(
        transition=transition,
        reward=rng.normal(0, 3, transition.shape),
        noise=rng.exponential(4, transition.shape),
        start=np.append(np.full(states - 1, 1 / (states - 1)), 0.0),
    )


def chain(certain=False):
    """Five states in a row, then the end. Action 1 pays more, with noise, and may fall back.

    `certain`: both actions go one state on, always.
    """
    transition, reward, noise = np.zeros((3, 6, 2, 6))
    for state in range(5):
        back = max(state - 1, 0)
        for action, on in enumerate((1.0, 1.0) if certain else (0.9, 0.6)):
            transition[state, action, state + 1] += on
            transition[state, action, back] += 1 - on
            reward[state, action] = state + 2.0 * action
            noise[state, action] = 4.0 * action
    return Mdp(
        transition=transition, reward=reward, noise=noise, start=np.array([0.5, 0, 0.5, 0, 0, 0])
    )


def random_policy(mdp, seed):
    return np.random.default_rng(seed).dirichlet(
        np.ones(mdp.transition.shape[1]), mdp.transition.shape[0]
    )


def walk(mdp, policy, state, rng, action=None, most=3000):
    """Steps of many walks at once, from states [B] and, if given, first actions [B].

    Yields (state, action, reward, next state) of each step, with all walks in every step; those
    that are over stay where they are and are paid nothing.
    """
    ways = np.add.accumulate(mdp.transition, axis=2)
    choices = np.add.accumulate(policy, axis=1)[:, :-1]
    terminal = ~mdp.transition.any(axis=(1, 2))
    for _ in range(most):
        if action is None:
            action = (rng.random((len(state), 1)) >= choices[state]).sum(axis=1)
        over = terminal[state]
        there = (rng.random((len(state), 1)) >= ways[state, action][:, :-1]).sum(axis=1)
        there = np.where(over, state, there)
        paid = rng.normal(
            mdp.reward[state, action, there], np.sqrt(mdp.noise[state, action, there])
        )
        next_action = (rng.random((len(state), 1)) >= choices[there]).sum(axis=1)
        yield state, action, np.where(over, 0.0, paid), there, next_action
        state, action = there, next_action
        if terminal[state].all():
            return
