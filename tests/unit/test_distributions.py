"""Log-probabilities, KL and their gradients: by hand, and against torch."""

from math import log, pi
from typing import Any

import numpy as np
import pytest
import torch
from torch.distributions import Categorical as TorchCategorical
from torch.distributions import Independent, Normal, kl_divergence

from dppo.distributions import Categorical, DiagonalGaussian, distribution_of
from dppo.spaces import Spaces

NOTHING: Any = np.empty(0)  # log std of a categorical


def _row(*numbers):
    return np.array([numbers], float)


def _vector(*numbers):
    return np.array(numbers, float)


def _torch(output, log_std, sizes):
    """torch's distribution of the same parameters, one per component of a discrete action."""
    if not sizes:
        return [Independent(Normal(output, log_std.exp()), 1)]
    return [TorchCategorical(logits=part) for part in output.split(list(sizes), dim=-1)]


def _draws(sizes, rng):
    """A distribution, old and new (output, log std), and actions for six states."""
    width, log_std_size = sum(sizes) or 2, 0 if sizes else 2
    old, new = rng.normal(size=(2, 6, width))
    old_log_std, log_std = 0.5 * rng.normal(size=(2, log_std_size))
    action = rng.normal(size=(6, 2))
    if sizes:
        action = np.stack([rng.integers(n, size=6) for n in sizes], axis=1).astype(float)
    distribution = Categorical(sizes) if sizes else DiagonalGaussian(2)
    return distribution, old, old_log_std, new, log_std, action


def test_kl_of_gaussians_by_hand():
    # N(0, 1) x N(0, 1) to N(1, 2²) x N(0, 1):
    # log 2 + (1 + 1²) / (2 * 2²) - 1/2 = log 2 - 1/4, and 0
    kl = DiagonalGaussian(2).kl(_row(0, 0), _vector(0, 0), _row(1, 0), _vector(log(2), 0))
    np.testing.assert_allclose(kl, [log(2) - 0.25], rtol=1e-15)


def test_kl_goes_from_the_old_policy_to_the_new_one():
    # the other way round: log 1/2 + (4 + 1) / 2 - 1/2 = 2 - log 2
    kl = DiagonalGaussian(2).kl(_row(1, 0), _vector(log(2), 0), _row(0, 0), _vector(0, 0))
    np.testing.assert_allclose(kl, [2 - log(2)], rtol=1e-15)


def test_log_prob_of_a_gaussian_by_hand():
    # z = (3 - 1) / 2 = 1 and z = -1: -1/2 - log 2 - 1/2 log 2 pi, and -1/2 - 1/2 log 2 pi
    found = DiagonalGaussian(2).log_prob(_row(1, 0), _vector(log(2), 0), _row(3, -1))
    expected = -1 - log(2) - log(2 * pi)
    np.testing.assert_allclose(found, [expected], rtol=1e-7)  # its constant is a float32


def test_kl_of_categoricals_by_hand():
    # (1/2, 1/2) to (1/4, 3/4): 1/2 log 2 + 1/2 log 2/3 = 1/2 log 4/3
    kl = Categorical((2,)).kl(_row(0, 0), NOTHING, _row(0, log(3)), NOTHING)
    np.testing.assert_allclose(kl, [0.5 * log(4 / 3)], rtol=1e-14)


def test_kl_of_a_multi_discrete_policy_is_the_sum_over_components():
    # as above, and (1/3, 1/3, 1/3) to (1/4, 1/4, 1/2): 2/3 log 4/3 + 1/3 log 2/3
    old, new = _row(0, 0, 5, 5, 5), _row(0, log(3), 0, 0, log(2))
    kl = Categorical((2, 3)).kl(old, NOTHING, new, NOTHING)
    expected = 0.5 * log(4 / 3) + 2 / 3 * log(4 / 3) + 1 / 3 * log(2 / 3)
    np.testing.assert_allclose(kl, [expected], rtol=1e-14)


def test_log_prob_of_a_multi_discrete_action_by_hand():
    # 3/4 for choice 1 of component 0, 1/2 for choice 2 of component 1
    output = _row(0, log(3), 0, 0, log(2))
    found = Categorical((2, 3)).log_prob(output, NOTHING, _row(1, 2))
    np.testing.assert_allclose(found, [log(3 / 8)], rtol=1e-6)  # summed in float32


def test_logits_of_any_size_do_not_overflow():
    found = Categorical((2,)).log_prob(_row(1e4, 0), NOTHING, _row(1))
    np.testing.assert_array_equal(found, [-1e4])


@pytest.mark.parametrize("sizes", [(), (3,), (2, 3, 2)])
def test_log_prob_and_its_gradient_are_torchs(sizes):
    distribution, _, _, output, log_std, action = _draws(sizes, np.random.default_rng(3))
    mean, spread = torch.tensor(output, requires_grad=True), torch.tensor(log_std)
    spread.requires_grad_()
    parts = _torch(mean, spread, sizes)
    taken = torch.tensor(action)
    columns = [taken] if not sizes else list(taken.unbind(dim=-1))
    expected = torch.stack([d.log_prob(a) for d, a in zip(parts, columns, strict=True)]).sum(0)
    found = distribution.log_prob(output, log_std, action)
    np.testing.assert_allclose(found, expected.detach().numpy(), rtol=1e-6)

    by_output, by_log_std = distribution.log_prob_gradient(output, log_std, action)
    expected.sum().backward()
    assert mean.grad is not None
    np.testing.assert_allclose(by_output, mean.grad.numpy(), rtol=1e-12, atol=1e-14)
    if not sizes:
        assert spread.grad is not None
        total = by_log_std.sum(axis=0)
        np.testing.assert_allclose(total, spread.grad.numpy(), rtol=1e-12)


@pytest.mark.parametrize("sizes", [(), (3,), (2, 3, 2)])
def test_kl_and_its_gradient_are_torchs(sizes):
    distribution, old, old_log_std, new, log_std, _ = _draws(sizes, np.random.default_rng(4))
    mean, spread = torch.tensor(new, requires_grad=True), torch.tensor(log_std)
    spread.requires_grad_()
    before = _torch(torch.tensor(old), torch.tensor(old_log_std), sizes)
    after = _torch(mean, spread, sizes)
    expected = torch.stack([kl_divergence(p, q) for p, q in zip(before, after, strict=True)]).sum(
        0
    )
    found = distribution.kl(old, old_log_std, new, log_std)
    np.testing.assert_allclose(found, expected.detach().numpy(), rtol=1e-12)

    by_output, by_log_std = distribution.kl_gradient(old, old_log_std, new, log_std)
    expected.sum().backward()
    assert mean.grad is not None
    np.testing.assert_allclose(by_output, mean.grad.numpy(), rtol=1e-12, atol=1e-14)
    if not sizes:
        assert spread.grad is not None
        total = by_log_std.sum(axis=0)
        np.testing.assert_allclose(total, spread.grad.numpy(), rtol=1e-12)


@pytest.mark.parametrize("sizes", [(), (2, 3)])
def test_slots_side_by_side_have_the_bits_of_each_alone(sizes):
    distribution, old, old_log_std, new, log_std, action = _draws(sizes, np.random.default_rng(5))
    old, new, action = (x.reshape(3, 2, -1).astype(np.float32) for x in (old, new, action))
    old_log_std, log_std = old_log_std.astype(np.float32), log_std.astype(np.float32)

    def everything(rows):
        return [
            distribution.log_prob(new[rows], log_std, action[rows]),
            distribution.kl(old[rows], old_log_std, new[rows], log_std),
            distribution.log_prob_gradient(new[rows], log_std, action[rows])[0],
            distribution.kl_gradient(old[rows], old_log_std, new[rows], log_std)[0],
        ]

    together = everything(slice(0, 3))
    for slot in range(3):
        for whole, alone in zip(together, everything(slot), strict=True):
            assert whole.dtype == np.float32
            assert whole[slot].tobytes() == alone.tobytes()


def test_gaussian_samples_are_mean_plus_std_times_noise():
    distribution = DiagonalGaussian(2)
    scaled = distribution.scaled(_row(0.5, -1), _vector(log(2), 0))
    sample = distribution.sample(_row(1, 2), scaled)
    np.testing.assert_allclose(sample, [[2, 1]], rtol=1e-15)
    np.testing.assert_array_equal(distribution.mode(_row(1, 2)), [[1, 2]])


def test_gumbel_noise_draws_choices_in_proportion():
    distribution = Categorical((2, 3))
    noise = distribution.noise(np.random.default_rng(6), (20_000,))
    output: Any = np.tile(_row(0, log(3), 0, 0, log(2)), (20_000, 1))
    action = distribution.sample(output, distribution.scaled(noise, NOTHING))
    # four standard errors: 4 sqrt(p (1 - p) / 20000) <= 0.0142
    assert action[:, 0].mean() == pytest.approx(0.75, abs=0.0123)
    assert (action[:, 1] == 2).mean() == pytest.approx(0.5, abs=0.0142)
    assert set(action[:, 1]) == {0, 1, 2}


def test_the_mode_of_a_multi_discrete_policy_is_each_components_best():
    found = Categorical((2, 3)).mode(_row(0, 1, 7, 2, 3))
    np.testing.assert_array_equal(found, [[1, 0]])


def test_the_distribution_follows_the_action_space():
    box = Spaces(obs_size=1, action_kind="box", action_sizes=(4,))
    discrete = Spaces(obs_size=1, action_kind="discrete", action_sizes=(2, 3))
    assert distribution_of(box) == DiagonalGaussian(4)
    assert distribution_of(discrete) == Categorical((2, 3))
