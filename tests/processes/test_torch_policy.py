"""`PolicyModule`: what others load acts like the trainer's policy, or says what does not fit."""

import numpy as np
import pytest
import torch
from gymnasium import spaces

from dppo.store.contents import chosen
from dppo.torch_policy import PolicyModule
from workers.envs import make_env
from workers.evaluate import policy_of


@pytest.fixture
def loaded(runs):
    """The trainer's policy, its action space, and how to load its checkpoint for a space."""

    def load(env_id, *words):
        _, checkpoint = chosen(str(runs(env_id, *words)), "newest")
        policy = policy_of(checkpoint)
        space = make_env(policy.config.run).action_space
        return policy, space, lambda space: PolicyModule.load(checkpoint, space)

    return load


def test_it_acts_like_the_trainer_policy_within_the_bounds_of_the_space(loaded):
    policy, space, load = loaded("InvertedPendulum-v5")
    obs = 3 * np.random.default_rng(0).normal(size=(16, 4))
    expected = np.stack([policy.act(row, 0, None) for row in obs])
    actions = load(space)(torch.from_numpy(obs)).numpy()
    np.testing.assert_allclose(actions, expected, atol=2e-6)
    edge = float(np.median(np.abs(expected)))
    narrow = load(spaces.Box(-edge, edge, (1,)))(torch.from_numpy(obs)).numpy()
    np.testing.assert_allclose(narrow, np.clip(expected, -edge, edge), atol=2e-6)
    assert (np.abs(narrow - expected) > 1e-3).any()


def test_continuous_samples_are_means_with_the_policys_noise_clipped_to_the_space(loaded):
    policy, _, load = loaded("InvertedPendulum-v5")
    obs = torch.zeros(4000, 4, dtype=torch.float64)
    actions = load(spaces.Box(-np.inf, np.inf, (1,))).sample(obs, torch.Generator().manual_seed(0))
    _, log_std = policy.networks.split_policy(policy.parameters)
    assert actions.std().item() == pytest.approx(float(np.exp(log_std[0])), rel=0.05)
    assert actions.mean().item() == pytest.approx(policy.act(np.zeros(4), 0, None)[0], abs=0.05)
    tight = load(spaces.Box(-0.05, 0.05, (1,)))
    clipped = tight.sample(obs, torch.Generator().manual_seed(0)).numpy()
    np.testing.assert_allclose(clipped, np.clip(actions.numpy(), -0.05, 0.05), atol=1e-7)


@pytest.mark.slow
def test_discrete_actions_are_numbers_that_the_environment_takes(loaded):
    policy, space, load = loaded("tests.odd_envs:Choices-v0")  # 3 from 1 on, and 2 from -1 on
    module = load(space)
    obs = torch.zeros(6000, 2, dtype=torch.float64)
    actions = module.sample(obs, torch.Generator().manual_seed(0)).numpy()
    assert all(row in space for row in actions.astype(space.dtype))
    assert [sorted(set(column)) for column in actions.T] == [[1, 2, 3], [-1, 0]]
    vector, _ = policy.networks.split_policy(policy.parameters)
    logits, _ = policy.networks.policy.forward(vector, policy.seen(np.zeros((1, 2)), np.zeros(1)))
    share = np.exp(logits[0, :3]) / np.exp(logits[0, :3]).sum()
    np.testing.assert_allclose(np.bincount(actions[:, 0])[1:] / 6000, share, atol=0.03)
    assert all(row in space for row in module(obs[:3]).numpy().astype(space.dtype))


def test_observations_of_another_size_are_refused_by_all(loaded):
    policy, space, load = loaded("InvertedPendulum-v5")
    module = load(space)
    for act in (module, module.sample):
        with pytest.raises(ValueError, match=r"have shape \[3, 1\], expected \[N, 4\]"):
            act(torch.zeros(3, 1))
        with pytest.raises(ValueError, match=r"have shape \[4\], expected \[N, 4\]"):
            act(torch.zeros(4))
    for shape in ((1,), (3,), (4, 1), ()):
        with pytest.raises(ValueError, match=r"has shape \(.*\), expected \(4,\)"):
            policy.act(np.zeros(shape), 0, None)
    with pytest.raises(ValueError, match=r"has shape \(1,\), expected \(4,\)"):
        policy.actions(np.zeros((3, 1)), np.zeros(3), None)
    with pytest.raises(ValueError, match=r"steps have shape \(1,\), expected \(3,\)"):
        policy.outlook(np.zeros((3, 4)), np.zeros(1, int))
    with pytest.raises(ValueError, match=r"an observation has shape \(3,\), expected \(4,\)"):
        policy.act([0.0] * 3, 0, None)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:`torch.jit")
def test_a_script_of_it_needs_no_gradients_and_refuses_too(loaded):
    _, space, load = loaded("InvertedPendulum-v5")
    script = torch.jit.script(load(space))
    script(torch.zeros(3, 4)).numpy()
    with pytest.raises(torch.jit.Error, match=r"have shape \[3, 1\], expected \[N, 4\]"):
        script(torch.zeros(3, 1))


@pytest.mark.slow
def test_a_time_feature_needs_the_steps(loaded):
    _, space, load = loaded("InvertedPendulum-v5", "--time-limit", "time-feature")
    module = load(space)
    with pytest.raises(ValueError, match=r"steps is missing, expected the steps since the reset"):
        module(torch.zeros(2, 4))
    assert module(torch.zeros(2, 4), torch.zeros(2)).shape == (2, 1)


@pytest.mark.parametrize(
    "space",
    [spaces.Box(-1, 1, (3, 2)), spaces.Discrete(3), spaces.MultiDiscrete([2, 3]), spaces.Text(3)],
    ids=str,
)
def test_a_space_of_another_kind_or_size_is_refused(loaded, space):
    _, _, load = loaded("tests.odd_envs:Choices-v0")
    with pytest.raises(ValueError, match=r"of the kind discrete with sizes \(3, 2\)"):
        load(space)
