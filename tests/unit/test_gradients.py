"""The gradient of one update for several slots: against torch, and bit by bit."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch.distributions import Categorical as TorchCategorical
from torch.distributions import Independent, Normal, kl_divergence

from dppo.config import (
    Config,
    KlConfig,
    NetworkConfig,
    SafetyConfig,
)
from dppo.distributions import distribution_of
from dppo.experience import Experience, critics_table
from dppo.gradients import Minibatch, Sums, block_gradient, slot_kls
from dppo.networks import Networks
from dppo.spaces import Spaces

BOX = Spaces(obs_size=3, action_kind="box", action_sizes=(2,))
DISCRETE = Spaces(obs_size=3, action_kind="discrete", action_sizes=(3,))
MULTI = Spaces(obs_size=3, action_kind="discrete", action_sizes=(2, 3))
SAMPLES, BETA = 21, 0.7
HINGE, NO_HINGE = KlConfig(kl_target=1e-4, hinge_coef=5.0), KlConfig(kl_target=10.0)


def _config(kl=NO_HINGE, head="softplus", critic=True):
    return Config(
        safety=SafetyConfig(sigma_head=head, variance_critic=critic),
        kl=kl,
        network=NetworkConfig(hidden_sizes=(5, 4)),
    )


class Block:
    """Networks, parameters after some updates, and the experience of a few slots."""

    def __init__(self, spaces, config, slots, samples=SAMPLES, replayed=1):
        rng = np.random.default_rng(7)
        self.spaces, self.config = spaces, config
        self.networks = Networks.build(spaces, config)
        self.distribution = distribution_of(spaces)
        size = self.networks.size
        self.old = (0.4 * rng.normal(size=size)).astype(np.float32)
        self.new = self.old + (0.1 * rng.normal(size=size)).astype(np.float32)
        self.experiences = [self._experience(rng, samples, replayed) for _ in range(slots)]
        self.advantages = [rng.normal(size=samples).astype(np.float32) for _ in range(slots)]
        for experience, advantage in zip(self.experiences, self.advantages, strict=True):
            experience.advantage[:] = advantage

    def _experience(self, rng, samples, replayed):
        def draw(*shape):
            return rng.normal(size=shape).astype(np.float32)

        policy, log_std = self.networks.split_policy(self.old)
        obs, stored = draw(samples, self.spaces.obs_size), replayed * samples
        output, _ = self.networks.policy.forward(policy, obs)
        noise = self.distribution.noise(rng, (samples,))
        action = self.distribution.sample(output, self.distribution.scaled(noise, log_std))
        targets = (draw(stored), np.square(draw(stored)))
        seen = np.concatenate([obs, draw(stored - samples, self.spaces.obs_size)])
        return Experience.of(
            obs=obs,
            action=action,
            output_old=output,
            log_std_old=log_std.copy(),
            log_prob_old=self.distribution.log_prob(output, log_std, action),
            a_v=np.zeros(samples),
            a_sigma=np.zeros(samples),
            critics=critics_table(seen, *targets),
        )

    def gradient(self, slots, minibatches, config=None):
        return block_gradient(
            self.networks,
            self.distribution,
            self.new,
            [self.experiences[slot] for slot in slots],
            minibatches,
            BETA,
            config or self.config,
        )


def _rows(*numbers):
    return np.array(numbers, np.int64)


SEVEN = _rows(20, 3, 5, 0, 11, 12, 7)
OTHER_SEVEN = _rows(1, 2, 3, 4, 6, 8, 19)


def _double(array):
    return torch.tensor(array, dtype=torch.float64)


def _forward(mlp, vector, x):
    for index, (weight, bias) in enumerate(mlp.layers(vector)):
        x = (torch.tanh(x) if index else x) @ weight + bias
    return x


def _policies(block, output, log_std):
    if block.spaces.action_kind == "box":
        return [Independent(Normal(output, log_std.exp()), 1)]
    sizes = list(block.spaces.action_sizes)
    return [TorchCategorical(logits=part) for part in output.split(sizes, dim=-1)]


def _torch_loss(block, slot, rows, parameters):
    """-J + L_V + L_sigma of one slot as means, in float64, and what `Sums` says of it."""
    experience, networks, kl = block.experiences[slot], block.networks, block.config.kl
    table, seen_by = experience.policy[rows.policy], experience.critics[rows.critics]
    columns = experience.columns
    v_target, sigma_target = columns.v_target(seen_by), columns.sigma_target(seen_by)
    layers, log_std = networks.split_policy(parameters)
    old = _policies(block, _double(columns.output_old(table)), _double(experience.log_std_old))
    new = _policies(block, _forward(networks.policy, layers, _double(columns.obs(table))), log_std)
    action = _double(columns.action(table))
    parts = [action] if block.spaces.action_kind == "box" else action.unbind(dim=-1)
    pairs = list(zip(new, parts, strict=True))
    log_prob = torch.stack([policy.log_prob(column) for policy, column in pairs]).sum(0)
    ratio = torch.exp(log_prob - _double(columns.log_prob_old(table)))
    divergence = torch.stack(
        [kl_divergence(p, q) for p, q in zip(old, new, strict=True)]
    ).sum(0).mean()  # fmt: skip
    excess = torch.clamp(divergence - 2 * kl.kl_target, min=0)
    gain = (ratio * _double(columns.advantage(table))).mean()
    objective = gain - BETA * divergence - kl.hinge_coef * excess**2

    seen = _double(columns.obs(seen_by))
    value = _forward(networks.value, parameters[networks.parts["value"]], seen)[:, 0]
    value_loss = ((value - _double(v_target)) ** 2).mean()
    sigma = _forward(networks.value, parameters[networks.parts["variance"]], seen)[:, 0]
    if block.config.safety.sigma_head == "softplus":
        sigma = torch.nn.functional.softplus(sigma)
    variance_loss = ((sigma - _double(sigma_target)) ** 2).mean()
    return divergence, objective, value_loss, variance_loss


@pytest.mark.parametrize("spaces", [BOX, DISCRETE, MULTI], ids=["box", "discrete", "multi"])
@pytest.mark.parametrize("kl", [HINGE, NO_HINGE], ids=["hinge", "no hinge"])
@pytest.mark.parametrize("head", ["softplus", "linear"])
def test_the_gradient_is_torchs(spaces, kl, head):
    # critics see twice as many rows as the policy, half of them replayed
    block = Block(spaces, _config(kl, head), slots=2, replayed=2)
    minibatches = [
        Minibatch(policy=SEVEN, critics=np.concatenate([SEVEN, 21 + OTHER_SEVEN])),
        Minibatch(policy=OTHER_SEVEN, critics=np.concatenate([21 + SEVEN, SEVEN])),
    ]
    vectors, sums = block.gradient([0, 1], minibatches)
    for slot, rows in enumerate(minibatches):
        parameters = _double(block.new).requires_grad_()
        divergence, objective, *losses = _torch_loss(block, slot, rows, parameters)
        assert bool(divergence > 2 * kl.kl_target) == (kl is HINGE)
        # sums over samples: 7 of the policy, 14 of the critics
        (-7 * objective + 14 * sum(losses)).backward()
        assert parameters.grad is not None
        for part in block.networks.parts.values():
            expected = parameters.grad[part].numpy()
            distance = np.linalg.norm(vectors[slot, part] - expected)
            assert distance < 1e-6 * np.linalg.norm(expected)
        found = Sums.from_vector(sums[slot])
        assert (found.policy_weight, found.kl_weight, found.critic_weight) == (7, 7, 14)
        # a KL is a small difference of float32 numbers near 1: 1e-7 each
        assert found.mean_kl == pytest.approx(divergence.item(), abs=1e-7)
        assert found.objective == pytest.approx(7 * objective.item(), rel=1e-5)
        assert found.value_loss == pytest.approx(14 * losses[0].item(), rel=1e-6)
        assert found.variance_loss == pytest.approx(14 * losses[1].item(), rel=1e-6)


SIZES = [((64, 64), 11, 64), ((5,), 3, 7), ((64, 64), 17, 1)]


@pytest.mark.parametrize("kind", ["box", "discrete"])
@pytest.mark.parametrize(("hidden", "obs", "rows"), SIZES)
def test_a_slots_row_has_the_same_bits_alone_among_three_and_among_eight(kind, hidden, obs, rows):
    spaces = Spaces(obs_size=obs, action_kind=kind, action_sizes=(3,))
    config = replace(_config(HINGE), network=NetworkConfig(hidden_sizes=hidden))
    block = Block(spaces, config, slots=8, samples=2 * rows)
    rng = np.random.default_rng(8)
    batches = []
    for _ in range(8):
        chosen = rng.permutation(2 * rows)[:rows]
        batches.append(Minibatch(policy=chosen, critics=chosen))
    vectors, sums = block.gradient(range(8), batches)
    for slots in [[slot] for slot in range(8)] + [[0, 1, 2], [5, 1, 7], [3, 4, 5, 6]]:
        some, some_sums = block.gradient(slots, [batches[slot] for slot in slots])
        assert some.tobytes() == vectors[slots].tobytes()
        assert some_sums.tobytes() == sums[slots].tobytes()


def test_policy_and_value_have_the_same_bits_with_and_without_a_variance_network():
    block = Block(BOX, _config(HINGE), slots=3)
    batches = [Minibatch(policy=SEVEN, critics=SEVEN)] * 3
    with_it, sums = block.gradient(range(3), batches)
    without = Networks.build(BOX, _config(HINGE, critic=False))
    vectors, other_sums = block_gradient(
        without,
        block.distribution,
        block.new[: without.size],
        block.experiences,
        batches,
        BETA,
        _config(HINGE, critic=False),
    )
    assert vectors.tobytes() == with_it[:, : without.size].tobytes()
    assert other_sums[:, :6].tobytes() == sums[:, :6].tobytes()
    assert (other_sums[:, 6] == 0).all()


def test_a_slot_without_policy_rows_sends_a_zero_policy_part_of_weight_0():
    block = Block(BOX, _config(HINGE), slots=3)
    both = Minibatch(policy=SEVEN, critics=OTHER_SEVEN)
    critics_only = Minibatch(policy=None, critics=OTHER_SEVEN)
    vectors, sums = block.gradient(range(3), [both, critics_only, both])
    all_active, all_sums = block.gradient(range(3), [both] * 3)
    policy = block.networks.parts["policy"]
    assert (vectors[1, policy] == 0).all()
    assert vectors[1, policy.stop :].tobytes() == all_active[1, policy.stop :].tobytes()
    assert vectors[[0, 2]].tobytes() == all_active[[0, 2]].tobytes()
    idle = Sums.from_vector(sums[1])
    assert (idle.policy_weight, idle.kl_weight, idle.kl, idle.objective) == (0, 0, 0, 0)
    assert idle.critic_weight == 7
    assert sums[[0, 2]].tobytes() == all_sums[[0, 2]].tobytes()


def test_without_critic_rows_the_critics_parts_are_zero():
    block = Block(BOX, _config(HINGE), slots=2)
    vectors, sums = block.gradient([0, 1], [Minibatch(policy=SEVEN, critics=None)] * 2)
    assert (vectors[:, block.networks.parts["policy"].stop :] == 0).all()
    assert [Sums.from_vector(row).critic_weight for row in sums] == [0, 0]
    assert (vectors[:, block.networks.parts["policy"]] != 0).any()


def test_under_kl_scope_worker_a_slot_past_the_stop_sends_a_skip_token_with_its_kl():
    batches = [Minibatch(policy=SEVEN, critics=SEVEN)] * 2
    block = Block(BOX, _config(), slots=2)
    free, free_sums = block.gradient([0, 1], batches)
    kls = [Sums.from_vector(row).mean_kl for row in free_sums]
    assert kls[0] != kls[1]
    # 4 KL_target lies between the two slots
    limit = KlConfig(kl_target=sum(kls) / 8, hinge_coef=0.0, kl_scope="worker")
    vectors, sums = block.gradient([0, 1], batches, replace(block.config, kl=limit))
    stopped, running = (0, 1) if kls[0] > kls[1] else (1, 0)
    policy = block.networks.parts["policy"]
    assert (vectors[stopped, policy] == 0).all()
    assert vectors[stopped, policy.stop :].tobytes() == free[stopped, policy.stop :].tobytes()
    assert vectors[running].tobytes() == free[running].tobytes()
    token = Sums.from_vector(sums[stopped])
    assert (token.policy_weight, token.objective, token.kl_weight) == (0, 0, 7)
    assert token.mean_kl == kls[stopped]


def test_under_kl_scope_chief_no_slot_stops_by_itself():
    block = Block(BOX, _config(KlConfig(kl_target=1e-9)), slots=1)
    _, sums = block.gradient([0], [Minibatch(policy=SEVEN, critics=SEVEN)])
    assert Sums.from_vector(sums[0]).policy_weight == 7


def test_the_kl_of_a_slot_has_the_same_bits_alone_and_beside_others():
    block = Block(BOX, _config(), slots=3)
    arguments = block.networks, block.distribution, block.new
    kls, weights = slot_kls(*arguments, block.experiences)
    assert kls.tolist() == [slot_kls(*arguments, [one])[0][0] for one in block.experiences]
    assert len(set(kls)) == 3
    assert weights.tolist() == [SAMPLES] * 3


def test_slot_kls_sum_over_all_samples_of_a_slot():
    block = Block(BOX, _config(), slots=1)
    everything = np.arange(SAMPLES)
    _, sums = block.gradient([0], [Minibatch(policy=everything, critics=None)])
    (kl,), _ = slot_kls(block.networks, block.distribution, block.new, block.experiences)
    assert kl == pytest.approx(Sums.from_vector(sums[0]).kl, rel=1e-6)
    (unmoved,), _ = slot_kls(block.networks, block.distribution, block.old, block.experiences)
    assert unmoved == 0.0
