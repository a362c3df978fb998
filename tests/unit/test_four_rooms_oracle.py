"""The oracle: exact V and σ, against closed forms, published facts and sampled episodes."""

import itertools

import numpy as np
import pytest

from dppo.four_rooms.mdp import Mdp
from dppo.four_rooms.optimum import best, one_hot, policy_iteration, single_changes
from dppo.four_rooms.oracle import evaluate, sarsa_fixed_point
from dppo.four_rooms.world import World
from tests.unit.small_worlds import chain, random_policy, random_world, walk

WORLD = World()
CORNER = WORLD.number_of((1, 1))
GAMMA = 0.99


def test_variance_on_a_chain_of_three_states_has_its_closed_form():
    transition, noise = np.zeros((2, 4, 1, 4))
    for state, std in enumerate((1.0, 2.0, 3.0)):
        transition[state, 0, state + 1], noise[state, 0] = 1, std**2
    mdp = Mdp(transition=transition, reward=np.zeros((4, 1, 4)), noise=noise, start=np.eye(4)[0])
    found = evaluate(mdp, mdp.uniform, gamma=0.9, lambda_ret=1.0)
    # 9, then 4 + 0.81 x 9, then 1 + 0.81 x 11.29
    assert found.sigma == pytest.approx([10.1449, 11.29, 9.0, 0.0])


def test_the_variance_of_a_state_is_the_mean_over_its_actions():
    mdp = random_world(3)
    policy = random_policy(mdp, 4)
    found = evaluate(mdp, policy, 0.9, 0.95)
    assert (policy * found.sigma_sa).sum(axis=1) == pytest.approx(found.sigma, rel=1e-12)
    assert (policy * found.q).sum(axis=1) == pytest.approx(found.v, rel=1e-12)


def test_sarsa_leaves_out_the_choice_of_the_first_action():
    mdp = random_world(5)
    policy = random_policy(mdp, 6)
    by_state, by_action = (of(mdp, policy, 0.9, 1.0) for of in (evaluate, sarsa_fixed_point))
    choice = (policy * (by_state.q - by_state.v[:, None]) ** 2).sum(axis=1)
    assert by_action.sigma + choice == pytest.approx(by_state.sigma, rel=1e-12)


def test_the_risk_neutral_optimum_has_its_known_value_and_variance():
    optimum = best(WORLD.mdp, psi=0.0, gamma=GAMMA, lambda_ret=GAMMA)
    found = evaluate(WORLD.mdp, optimum.policy, GAMMA, GAMMA)
    start = WORLD.mdp.start
    assert optimum.actions.tolist() == policy_iteration(WORLD.mdp, GAMMA).tolist()
    assert round(float(start @ found.v), 2) == 45.85
    assert round(float(start @ found.sigma), 1) == 122.7
    assert round(float(found.v[CORNER]), 2) == 42.45
    assert round(float(found.sigma[CORNER])) == 381


@pytest.mark.parametrize(("psi", "variance"), [(0.008, "above"), (0.009, "below")])
def test_a_penalty_of_0_009_is_enough_to_walk_around_the_ice(psi, variance):
    optimum = best(WORLD.mdp, psi=psi, gamma=GAMMA, lambda_ret=GAMMA)
    sigma = evaluate(WORLD.mdp, optimum.policy, GAMMA, GAMMA).sigma[CORNER]
    assert ("above" if sigma > 100 else "below") == variance


def test_every_single_change_is_evaluated_exactly():
    mdp = random_world(7, states=5, actions=3)
    actions = np.array([0, 2, 1, 0, 0])
    after = single_changes(mdp, actions, psi=0.1, gamma=0.9, lambda_ret=0.95)
    for state, action in np.ndindex(5, 3):
        changed = actions.copy()
        changed[state] = action
        exact = evaluate(mdp, one_hot(changed, mdp), 0.9, 0.95).objective(mdp.start, 0.1)
        assert after[state, action] == pytest.approx(exact, rel=1e-10)


@pytest.mark.parametrize("psi", [0.0, 0.02, 0.1, 0.5])
def test_the_optimum_of_small_worlds_is_the_best_of_all_their_policies(psi):
    for seed in range(25):
        mdp = random_world(seed, states=5, actions=2)
        every = [
            evaluate(mdp, one_hot(np.array([*actions, 0]), mdp), 0.9, 0.95)
            for actions in itertools.product(range(2), repeat=4)
        ]
        most = max(one.objective(mdp.start, psi) for one in every)
        found = best(mdp, psi=psi, gamma=0.9, lambda_ret=0.95)
        assert found.objective == pytest.approx(most, rel=1e-10), seed


@pytest.mark.parametrize("psi", [0.02, 0.1, 0.5])
def test_no_random_policy_of_a_small_world_is_better_than_the_deterministic_optimum(psi):
    for seed in range(5):
        mdp = random_world(seed, states=4, actions=2)
        found = best(mdp, psi=psi, gamma=0.9, lambda_ret=0.95)
        for draw in range(100):
            policy = random_policy(mdp, draw)
            objective = evaluate(mdp, policy, 0.9, 0.95).objective(mdp.start, psi)
            assert objective <= found.objective


def sampled(mdp, policy, exact, lambdas, episodes=100_000):
    """λ-returns of episodes from the start distribution, [lambdas, episodes], and their starts.

    G^λ = Σ_k (γ λ)^k (r_{k+1} + γ (1 − λ) V(s_{k+1})), eq. 4 written out.
    """
    rng = np.random.default_rng(11)
    start = rng.choice(len(mdp.start), episodes, p=mdp.start)
    trace = np.array(lambdas)[:, None]
    weight, total = np.ones_like(trace), np.zeros((len(lambdas), episodes))
    going = np.arange(episodes)
    ended = ~mdp.transition.any(axis=(1, 2))
    state = start
    while len(going) and weight.max() > 1e-9:
        ((_, _, reward, there, _),) = itertools.islice(walk(mdp, policy, state, rng), 1)
        total[:, going] += weight * (reward + GAMMA * (1 - trace) * exact.v[there])
        weight = weight * GAMMA * trace
        on = ~ended[there]
        going, state = going[on], there[on]
    return total, start


@pytest.mark.slow
@pytest.mark.parametrize("which", ["uniform", "optimal", "random"])
def test_value_and_variance_agree_with_100_000_episodes(which):
    mdp = WORLD.mdp
    policy = {
        "uniform": mdp.uniform,
        "optimal": best(mdp, psi=0.0, gamma=GAMMA, lambda_ret=GAMMA).policy,
        "random": random_policy(mdp, 1),
    }[which]
    lambdas = (1.0, 0.99, 0.6)
    exact = evaluate(mdp, policy, GAMMA, 1.0)
    returns, start = sampled(mdp, policy, exact, lambdas)
    for trace, found in zip(lambdas, returns, strict=True):
        deviation = found - exact.v[start]
        assert within_three_errors(deviation), f"V at λ = {trace}"
        sigma = evaluate(mdp, policy, GAMMA, trace).sigma
        assert within_three_errors(deviation**2 - sigma[start]), f"σ at λ = {trace}"


def within_three_errors(differences):
    """Is the mean 0 but for three standard errors?"""
    return abs(differences.mean()) <= 3 * differences.std() / np.sqrt(len(differences))


@pytest.mark.slow
@pytest.mark.parametrize("trace", [0.99, 0.6, 1.0])
def test_the_fixed_point_of_sarsa_on_a_chain_agrees_with_100_000_episodes(trace):
    mdp = chain()
    policy = random_policy(mdp, 2)
    exact = sarsa_fixed_point(mdp, policy, GAMMA, trace)
    rng = np.random.default_rng(5)
    for state, action in np.ndindex(5, 2):
        states, actions = (np.full(100_000, place) for place in (state, action))
        weight, total = 1.0, np.zeros(100_000)
        for *_, reward, there, following in walk(mdp, policy, states, rng, action=actions):
            total += weight * (reward + GAMMA * (1 - trace) * exact.q[there, following])
            weight *= GAMMA * trace
        deviation = total - exact.q[state, action]
        assert within_three_errors(deviation), (state, action)
        assert within_three_errors(deviation**2 - exact.sigma_sa[state, action]), (state, action)


@pytest.mark.slow
def test_algorithm_1_rests_at_the_fixed_point_of_sarsa():
    mdp = chain()
    policy = random_policy(mdp, 2)
    exact = sarsa_fixed_point(mdp, policy, GAMMA, GAMMA)
    rng = np.random.default_rng(6)
    for state, action in np.ndindex(5, 2):
        states, actions = (np.full(100_000, place) for place in (state, action))
        *_, reward, there, following = next(walk(mdp, policy, states, rng, action=actions))
        delta = reward + GAMMA * exact.q[there, following] - exact.q[state, action]
        then = GAMMA**4 * exact.sigma_sa[there, following]  # γ̄ = (γ λ)², both 0.99
        assert within_three_errors(delta), (state, action)
        assert within_three_errors(delta**2 + then - exact.sigma_sa[state, action])
