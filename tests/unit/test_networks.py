"""Tanh networks on a flat vector: by hand, and against torch."""

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import torch

from dppo.config import Config, NetworkConfig, RolloutConfig, RunConfig, SafetyConfig
from dppo.networks import Mlp, Networks
from dppo.spaces import Spaces

BOX = Spaces(obs_size=3, action_kind="box", action_sizes=(2,))
DISCRETE = Spaces(obs_size=3, action_kind="discrete", action_sizes=(2, 4))


def _torch_forward(sizes, vector, x):
    at = 0
    for index, (fan_in, fan_out) in enumerate(pairwise(sizes)):
        if index:
            x = torch.tanh(x)
        weight = vector[at : at + fan_in * fan_out].reshape(fan_in, fan_out)
        at += fan_in * fan_out
        x = x @ weight + vector[at : at + fan_out]
        at += fan_out
    return x


def test_a_small_network_by_hand():
    # W1 = (1 2; 3 4) row by row, b1 = (5, 6), W2 = (7; 8), b2 = 9
    vector: Any = np.array([1, 2, 3, 4, 5, 6, 7, 8, 9], float)
    x: Any = np.array([[1.0, -1.0]])
    output, inputs = Mlp((2, 2, 1)).forward(vector, x)
    # x W1 + b1 = (1 - 3 + 5, 2 - 4 + 6) = (3, 4)
    np.testing.assert_array_equal(inputs[1], np.tanh([[3.0, 4.0]]))
    np.testing.assert_allclose(output, [[7 * np.tanh(3) + 8 * np.tanh(4) + 9]], rtol=1e-15)


@pytest.mark.parametrize("sizes", [(3, 2), (3, 4, 2), (5, 7, 5, 1)])
def test_forward_and_backward_are_torchs(sizes):
    rng = np.random.default_rng(1)
    mlp = Mlp(sizes)
    vector: Any = rng.normal(size=mlp.size)
    x: Any = rng.normal(size=(6, sizes[0]))
    slope: Any = rng.normal(size=(6, sizes[-1]))
    parameters = torch.tensor(vector, requires_grad=True)
    expected = _torch_forward(sizes, parameters, torch.tensor(x))
    (expected * torch.tensor(slope)).sum().backward()

    output, inputs = mlp.forward(vector, x)
    gradient: Any = np.empty(mlp.size)
    mlp.backward(vector, inputs, slope, gradient)
    assert parameters.grad is not None
    np.testing.assert_allclose(output, expected.detach().numpy(), rtol=1e-12)
    np.testing.assert_allclose(gradient, parameters.grad.numpy(), rtol=1e-12, atol=1e-13)


def test_a_network_reads_and_leaves_alone_its_input():
    mlp, x = Mlp((3, 4, 2)), np.ones((2, 3), np.float32)
    vector = np.ones(mlp.size, np.float32)
    mlp.forward(vector, x)
    assert (x == 1).all()
    assert (vector == 1).all()


@pytest.mark.parametrize("sizes", [(11, 64, 64, 3), (3, 5, 5, 1)])
@pytest.mark.parametrize("rows", [64, 7])
def test_slots_side_by_side_have_the_bits_of_each_alone(sizes, rows):
    rng = np.random.default_rng(2)
    mlp = Mlp(sizes)
    vector = rng.normal(size=mlp.size).astype(np.float32)
    x = rng.normal(size=(8, rows, sizes[0])).astype(np.float32)
    slope = rng.normal(size=(8, rows, sizes[-1])).astype(np.float32)

    def gradients(slots):
        output, inputs = mlp.forward(vector, x[slots])
        gradient = np.empty((len(x[slots]), mlp.size), np.float32)
        mlp.backward(vector, inputs, slope[slots], gradient)
        return output, gradient

    together = gradients(slice(0, 8))
    for slot in range(8):
        alone = gradients(slice(slot, slot + 1))
        assert together[0][slot].tobytes() == alone[0][0].tobytes()
        assert together[1][slot].tobytes() == alone[1][0].tobytes()


def test_the_vector_holds_policy_log_std_value_and_variance_in_this_order():
    config = Config(network=NetworkConfig(hidden_sizes=(4, 4)))
    networks = Networks.build(BOX, config)
    # policy 3 x 4 + 4, 4 x 4 + 4, 4 x 2 + 2 and two log stds; critics 3 x 4 + 4, 20, 4 + 1
    assert networks.parts == {
        "policy": slice(0, 48),
        "value": slice(48, 89),
        "variance": slice(89, 130),
    }
    assert networks.size == 130
    vector = np.arange(130, dtype=np.float32)
    layers, log_std = networks.split_policy(vector)
    np.testing.assert_array_equal(layers, np.arange(46))
    np.testing.assert_array_equal(log_std, [46, 47])


def test_a_discrete_policy_has_a_logit_per_choice_and_no_log_std():
    networks = Networks.build(DISCRETE, Config())
    assert networks.policy.sizes == (3, 64, 64, 6)
    assert networks.log_std_size == 0
    assert networks.parts["value"].start == networks.policy.size


def test_the_time_feature_is_one_more_input():
    config = Config(rollout=RolloutConfig(time_limit="time-feature"))
    networks = Networks.build(BOX, config)
    assert networks.policy.sizes[0] == networks.value.sizes[0] == 4


def test_the_papers_sizes_follow_from_the_environment():
    config = Config(network=NetworkConfig(architecture="paper"))
    networks = Networks.build(Spaces(obs_size=11, action_kind="box", action_sizes=(3,)), config)
    # 10 O = 110, 10 A = 30 and sqrt(110 * 30) = 57.4; critics 5 and sqrt(110 * 5) = 23.5
    assert networks.policy.sizes == (11, 110, 57, 30, 3)
    assert networks.value.sizes == (11, 110, 23, 5, 1)


def test_weights_begin_orthogonal_with_a_small_last_policy_layer():
    networks = Networks.build(BOX, Config(network=NetworkConfig(log_std_init=-0.7)))
    vector = networks.initial(Config(network=NetworkConfig(log_std_init=-0.7)))
    layers, log_std = networks.split_policy(vector)
    np.testing.assert_array_equal(log_std, np.array([-0.7, -0.7], np.float32))
    for gain, (weight, bias) in zip((2, 2, 0.01**2), networks.policy.layers(layers), strict=True):
        assert (bias == 0).all()
        tall = weight if weight.shape[0] >= weight.shape[1] else weight.T
        np.testing.assert_allclose(tall.T @ tall, gain * np.eye(tall.shape[1]), atol=gain * 1e-6)


def test_policy_and_value_begin_the_same_with_and_without_a_variance_network():
    spaces, run = BOX, RunConfig(seed=3)
    with_it = Config(run=run)
    without = Config(run=run, safety=SafetyConfig(variance_critic=False))
    one, other = Networks.build(spaces, with_it), Networks.build(spaces, without)
    assert not other.has_variance
    assert list(other.parts) == ["policy", "value"]
    assert one.initial(with_it)[: other.size].tobytes() == other.initial(without).tobytes()


def test_another_seed_gives_other_weights_and_the_networks_differ():
    one, other = Config(run=RunConfig(seed=0)), Config(run=RunConfig(seed=1))
    networks = Networks.build(BOX, one)
    vector = networks.initial(one)
    assert (vector != networks.initial(other)).any()
    assert (vector[networks.parts["value"]] != vector[networks.parts["variance"]]).any()
