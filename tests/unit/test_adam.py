"""Adam and clipping, beside torch's and by hand."""

import numpy as np
import pytest
import torch

from dppo.adam import AdamState, adam, clipped

ULP = float(np.spacing(np.float32(1)))  # 2**-23


def test_the_first_step_has_the_size_of_the_rate_whatever_the_gradient():
    gradient = np.array([3.0, -400.0, 0.0], np.float32)
    state, change = adam(AdamState.zero(3), gradient, 0.5, eps=1e-20)
    # m / (1 - β1) = g and √(v / (1 - β2)) = |g|, so the step is rate * sign(g)
    np.testing.assert_allclose(change[:2], [-0.5, 0.5], rtol=4 * ULP)
    assert change[2] == 0
    assert state.updates == 1


def test_two_steps_by_hand():
    state, _ = adam(AdamState.zero(1), np.array([1.0], np.float32), 1.0, beta1=0.5, beta2=0.75)
    state, change = adam(state, np.array([3.0], np.float32), 1.0, beta1=0.5, beta2=0.75, eps=1.0)
    assert state.mean == [0.5 * 0.5 + 0.5 * 3]  # 1.75
    assert state.square == [0.75 * 0.25 + 0.25 * 9]  # 2.4375
    by_hand = -(1.75 / 0.75) / (np.sqrt(2.4375 / 0.4375) + 1)
    np.testing.assert_allclose(change, [by_hand], rtol=4 * ULP)


@pytest.mark.parametrize("eps", [1e-8, 1e-5])
def test_twenty_steps_as_torch(eps):
    rng = np.random.default_rng(3)
    start = rng.standard_normal(200).astype(np.float32)
    theirs = torch.nn.Parameter(torch.from_numpy(start.copy()))
    optimizer = torch.optim.Adam([theirs], lr=3e-3, eps=eps)
    ours, state = start.copy(), AdamState.zero(200)
    for step in range(20):
        gradient = (rng.standard_normal(200) * 10.0 ** rng.integers(-6, 3, 200)).astype(np.float32)
        if step == 10:
            gradient[:] = 0
        theirs.grad = torch.from_numpy(gradient.copy())
        optimizer.step()
        state, change = adam(state, gradient, 3e-3, eps=eps)
        ours = ours + change
    moments = optimizer.state[theirs]
    np.testing.assert_allclose(state.square, moments["exp_avg_sq"].numpy(), rtol=8 * ULP)
    largest = np.abs(start).max() + 20 * 3e-3
    np.testing.assert_allclose(ours, theirs.detach().numpy(), rtol=0, atol=4 * ULP * largest)
    assert state.updates == 20


def test_every_parameter_may_have_its_own_rate():
    gradient = np.array([1.0, 1.0, 1.0], np.float32)
    rates = np.array([0.0, 0.1, 0.2], np.float32)
    _, change = adam(AdamState.zero(3), gradient, rates)
    alone = [adam(AdamState.zero(1), gradient[:1], float(rate))[1][0] for rate in rates]
    assert change.tolist() == alone
    assert change[0] == 0


def test_the_state_before_is_left_as_it_was():
    before = AdamState.zero(2)
    gradient = np.array([1.0, 2.0], np.float32)
    adam(before, gradient, 0.1)
    assert not before.mean.any()
    assert not before.square.any()
    assert before.updates == 0
    assert gradient.tolist() == [1.0, 2.0]


def test_everything_stays_in_single_precision():
    state, change = adam(AdamState.zero(2), np.ones(2, np.float32), 0.1)
    assert {state.mean.dtype, state.square.dtype, change.dtype} == {np.dtype(np.float32)}


def test_a_long_gradient_is_shortened_and_its_norm_told():
    gradient, norm = clipped(np.array([3.0, 4.0], np.float32), 1.0)
    assert norm == 5.0
    np.testing.assert_allclose(gradient, [0.6, 0.8], rtol=ULP)
    assert gradient.dtype == np.float32


@pytest.mark.parametrize("bound", [5.0, 6.0, float("inf")])
def test_a_gradient_within_the_bound_keeps_its_bits(bound):
    before = np.array([3.0, 4.0], np.float32)
    gradient, norm = clipped(before, bound)
    assert gradient.tobytes() == before.tobytes()
    assert norm == 5.0


def test_the_norm_does_not_overflow_single_precision():
    gradient, norm = clipped(np.full(4, 1e30, np.float32), 2.0)
    np.testing.assert_allclose(norm, 2e30, rtol=ULP)
    np.testing.assert_allclose(gradient, [1.0] * 4, rtol=2 * ULP)


def test_no_gradient_stays_none():
    gradient, norm = clipped(np.zeros(3, np.float32), 0.5)
    assert norm == 0
    assert gradient.tolist() == [0, 0, 0]
