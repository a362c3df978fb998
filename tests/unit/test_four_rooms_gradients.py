"""Eq. 15 and the exact gradient, against finite differences of the objective."""

import numpy as np
import pytest

from dppo.four_rooms.gradients import eq15, exact
from dppo.four_rooms.optimum import best
from dppo.four_rooms.oracle import evaluate
from dppo.four_rooms.world import World
from tests.unit.small_worlds import chain, random_policy, random_world

SETTINGS = {"gamma": 0.95, "lambda_ret": 0.9}
FOUR_ROOMS = World().mdp
TABLE_1 = {"gamma": 0.99, "lambda_ret": 0.99}


def softmax(theta):
    e = np.exp(theta)
    return e / e.sum(axis=1, keepdims=True)


def through_softmax(policy, factor):
    """[S, A] ∇_θ of Σ factor(s, a) π(a|s) for π = softmax(θ)."""
    return policy * (factor - (policy * factor).sum(axis=1, keepdims=True))


def differences(mdp, policy, psi):
    """∇_θ J by central differences; their error is about 1e-9 of the largest."""
    theta, step = np.log(policy), 1e-5
    gradient = np.zeros_like(theta)
    for place in np.ndindex(theta.shape):
        ends = []
        for sign in (1, -1):
            moved = theta.copy()
            moved[place] += sign * step
            found = evaluate(mdp, softmax(moved), SETTINGS["gamma"], SETTINGS["lambda_ret"])
            ends.append(found.objective(mdp.start, psi))
        gradient[place] = (ends[0] - ends[1]) / (2 * step)
    return gradient


def agree(one, other):
    assert one == pytest.approx(other, abs=1e-7 * abs(other).max())


@pytest.mark.parametrize("psi", [0.0, 0.1, 1.0])
def test_the_exact_gradient_is_that_of_finite_differences(psi):
    mdp = random_world(1, states=5, actions=3)
    policy = random_policy(mdp, 2)
    found = through_softmax(policy, exact(mdp, policy, psi=psi, **SETTINGS))
    agree(found, differences(mdp, policy, psi))


def test_equation_15_is_exact_without_a_penalty():
    mdp = random_world(3)
    policy = random_policy(mdp, 4)
    found = through_softmax(policy, eq15(mdp, policy, psi=0.0, **SETTINGS))
    agree(found, differences(mdp, policy, 0.0))


def test_equation_15_is_exact_where_the_next_state_is_certain():
    # what eq. 12 drops is the covariance of δ and ∇V(s'); a next state that is certain has none
    mdp = chain(certain=True)
    policy = random_policy(mdp, 5)
    found = through_softmax(policy, eq15(mdp, policy, psi=0.5, **SETTINGS))
    agree(found, differences(mdp, policy, 0.5))


def test_equation_15_is_not_exact_where_it_is_not():
    mdp = random_world(1)
    policy = random_policy(mdp, 2)
    found = through_softmax(policy, eq15(mdp, policy, psi=1.0, **SETTINGS))
    assert abs(found - differences(mdp, policy, 1.0)).max() > 0.01 * abs(found).max()


def cosine_of_variance_gradients(policy):
    """Of the angle between eq. 13 and the exact ∇σ on Four Rooms."""
    with_psi, without = ((of(FOUR_ROOMS, policy, psi=1, **TABLE_1), of(FOUR_ROOMS, policy, psi=0,
                         **TABLE_1)) for of in (eq15, exact))  # fmt: skip
    one, other = (through_softmax(policy, a - b) for a, b in (with_psi, without))
    return (one * other).sum() / np.sqrt((one**2).sum() * (other**2).sum())


def test_on_four_rooms_equation_13_is_17_degrees_from_the_exact_gradient_of_the_uniform_policy():
    cosine = cosine_of_variance_gradients(FOUR_ROOMS.uniform)
    assert round(cosine, 3) == 0.957
    assert round(np.degrees(np.arccos(cosine))) == 17


def test_near_the_optimum_equation_13_is_within_3_degrees_of_the_exact_gradient():
    optimum = best(FOUR_ROOMS, psi=0.01, **TABLE_1).policy
    cosine = cosine_of_variance_gradients(0.9 * optimum + 0.1 * FOUR_ROOMS.uniform)
    assert np.degrees(np.arccos(cosine)) < 3
