"""The reference itself, against central differences."""

import numpy as np
import pytest

from tests.golden import reference
from tests.golden import reference_networks as networks


def _numeric(loss, flat):
    """Central differences, step 1e-5: truncation and rounding errors are both about 1e-10."""
    gradient = np.zeros_like(flat)
    for index in range(len(flat)):
        step = np.zeros_like(flat)
        step[index] = 1e-5
        gradient[index] = (loss(flat + step) - loss(flat - step)) / 2e-5
    return gradient


@pytest.mark.parametrize("choices", [(), (3,), (2, 3)])
@pytest.mark.parametrize("target", [1e-3, 10.0])
def test_the_references_policy_gradient_is_the_slope_of_its_objective(choices, target):
    rng = np.random.default_rng(1)
    policy = networks.Policy(networks.Mlp((3, 4, sum(choices) or 2)), choices)
    old = rng.normal(size=policy.size)
    new = old + 0.2 * rng.normal(size=policy.size)
    obs, advantages = rng.normal(size=(6, 3)), rng.normal(size=6)
    actions = rng.normal(size=(6, 2))
    if choices:
        actions = np.stack([rng.integers(n, size=6) for n in choices], axis=1).astype(float)
    data = (old, obs, actions, advantages, reference.Kl(0.7, 5.0, target))
    assert (policy.kl(old, new, obs).mean() > 2 * target) == (target < 1)
    numeric = _numeric(lambda flat: -reference.objective(policy, flat, *data), new)
    np.testing.assert_allclose(
        reference.policy_gradient(policy, new, *data), numeric, rtol=1e-7, atol=1e-8
    )


def test_the_references_critic_gradients_are_the_slopes_of_their_losses():
    rng = np.random.default_rng(2)
    net = networks.Mlp((3, 4, 1))
    flat, obs, targets = rng.normal(size=net.size), rng.normal(size=(6, 3)), rng.normal(size=6)
    value = _numeric(lambda x: reference.value_loss(net, x, obs, targets), flat)
    found = reference.value_gradient(net, flat, obs, targets)
    np.testing.assert_allclose(found, value, rtol=1e-7, atol=1e-8)
    variance = _numeric(lambda x: reference.variance_loss(net, x, obs, targets, 0.3), flat)
    found = reference.variance_gradient(net, flat, obs, targets, 0.3)
    np.testing.assert_allclose(found, variance, rtol=1e-7, atol=1e-8)
