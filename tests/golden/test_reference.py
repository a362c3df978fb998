"""A real run, held against an independent NumPy implementation of the specification.

Everything that the messages of a run carry is recorded; then `reference.py` recomputes its
iterations from the raw facts (observations, actions, rewards, flags) alone. The first of the four
iterations only fills the shared statistics; the other three have updates.
"""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from dppo.config import SafetyConfig
from dppo.wire.messages import Collect, Collected, Measure, Update
from tests.golden.recomputation import Recomputation, samples
from tests.golden.recorded_run import (
    CASES,
    ITERATIONS,
    MAX_NORM,
    STEPS,
    TRAINED,
    UPDATES,
    WINDOW,
    config_of,
    record,
    train,
)


def _averaged(gradients):
    """What the chief makes of one update's messages."""
    vector = np.sum([g.vector.astype(np.float64) for g in gradients], axis=0)
    return vector / sum(g.sums[0] for g in gradients)


def _distance(found, expected):
    return np.linalg.norm(found - expected) / np.linalg.norm(expected)


@pytest.fixture(scope="module", params=list(CASES))
def both(request):
    run = record(config_of(request.param))
    recomputation = Recomputation(run)
    return run, [recomputation.redo(number) for number in range(ITERATIONS)], recomputation.parts


def test_the_run_holds_what_it_is_meant_to_hold(both):
    run, redone, _ = both
    for iteration in run.iterations:
        terminated = np.array([r.terminated for r in iteration.rollouts])
        truncated = np.array([r.ended for r in iteration.rollouts]) & ~terminated
        truncated[:, WINDOW - 1 :: WINDOW] = False  # cuts
        assert truncated.sum() >= 3
        assert terminated.sum() >= 3
    for step in redone[1:3]:
        assert step.hinges[0] == 0.0
        assert max(step.hinges) > 0.0
    assert run.iterations[2].collect.beta != run.iterations[1].collect.beta
    assert max(redone[1].critic_norms) > MAX_NORM


def test_the_first_iteration_asks_for_no_update_and_changes_nothing(both):
    run, _, _ = both
    first, second = run.iterations[:2]
    assert [type(message) for message in first.asked] == [Collect]
    assert {type(message) for message in first.answered} == {Collected}
    initial = run.networks.initial(run.config)
    assert first.collect.parameters.tobytes() == initial.tobytes()
    assert second.collect.parameters.tobytes() == initial.tobytes()
    assert first.collect.beta == second.collect.beta == run.config.kl.kl_coef


@pytest.mark.parametrize("number", TRAINED)
def test_every_later_iteration_updates_from_where_the_one_before_ended(both, number):
    run, _, _ = both
    before, iteration = run.iterations[number - 1 : number + 1]
    asked = [Collect] + [Update] * UPDATES + [Measure]
    assert [type(message) for message in iteration.asked] == asked
    start = before.parameters[-1].tobytes()
    assert iteration.collect.parameters.tobytes() == start
    assert iteration.parameters[0].tobytes() == start
    assert iteration.parameters[-1].tobytes() != start
    if number == ITERATIONS - 1:
        assert run.end.parameters.tobytes() == iteration.parameters[-1].tobytes()


def test_rollouts_are_cut_at_every_window_and_follow_each_episode_to_its_true_end(both):
    run, _, _ = both
    for iteration in run.iterations:
        for rollout in iteration.rollouts:
            assert rollout.ended[WINDOW - 1 :: WINDOW].all()
            follows = rollout.obs[1:] == rollout.next_obs[:-1]
            over = rollout.starts[1:]
            assert follows.all(axis=-1)[~over].all()
            assert not follows.all(axis=-1)[over].any()  # the final observation, not the reset's
            assert rollout.ended[:-1][over].all()
            cuts = np.zeros(STEPS, np.bool_)
            cuts[WINDOW - 1 :: WINDOW] = True
            assert (rollout.ended[:-1] == over | cuts[:-1, None]).all()
            assert over[rollout.terminated[:-1]].all()


def test_every_iteration_uses_the_scales_of_those_before_it(both):
    run, redone, _ = both
    raw = run.iterations[0].statistics
    assert redone[0].scales == (1.0, 1.0)
    assert (raw.reward_scale(run.config), raw.sigma_scale(run.config)) == (1.0, 1.0)
    for step, iteration in zip(redone[1:], run.iterations[1:], strict=True):
        statistics = iteration.statistics
        reward, sigma = step.scales
        assert statistics.reward_scale(run.config) == pytest.approx(reward, rel=1e-12)
        # targets of sigma come from float32 networks
        assert statistics.sigma_scale(run.config) == pytest.approx(sigma, rel=1e-5)
        assert abs(reward - 1) > 0.01
    assert redone[1].scales[1] == pytest.approx(1.0)  # the variance of scaled returns
    assert all(abs(step.scales[1] - 1) > 0.01 for step in redone[2:])
    assert len(redone) > 2


def test_the_first_iteration_sees_raw_observations(both):
    run, _, _ = both
    statistics = run.iterations[0].statistics
    assert statistics.obs.count == 0
    seen = np.linspace(-9, 9, run.spaces.obs_size)
    normalizer = statistics.obs_normalizer(run.config.rollout)
    assert normalizer(seen).tobytes() == seen.astype(np.float32).tobytes()


def test_the_second_iteration_sees_observations_normalised_by_the_first(both):
    run, _, _ = both
    first, second = (iteration.rollouts for iteration in run.iterations[:2])
    raw = np.concatenate([samples(r.obs) for r in first])  # the first iteration sees them raw
    mean, std = raw.mean(axis=0), np.sqrt(raw.var(axis=0) + 1e-8)
    compared = 0
    for before, after in zip(first, second, strict=True):
        for env in np.flatnonzero(~after.starts[0]):
            expected = np.clip((before.next_obs[-1, env] - mean) / std, -10, 10)
            np.testing.assert_allclose(after.obs[0, env], expected, rtol=1e-5, atol=1e-5)
            compared += 1
    assert compared > 0


@pytest.mark.parametrize("number", TRAINED)
def test_every_averaged_gradient_agrees(both, number):
    run, redone, parts = both
    assert len(run.iterations[number].gradients) == UPDATES
    for update, gradients in enumerate(run.iterations[number].gradients):
        found = _averaged(gradients)
        for name, part in zip(("policy", "value", "variance"), parts, strict=True):
            assert run.networks.parts[name] == part
            distance = _distance(found[part], redone[number].gradients[update][part])
            assert distance < 2e-5, f"update {update}, {name}: {distance:.2e}"


@pytest.mark.parametrize("number", TRAINED)
def test_parameters_after_every_update_agree(both, number):
    run, redone, parts = both
    start = run.iterations[number].parameters[0]
    for update in range(1, UPDATES + 1):
        found = run.iterations[number].parameters[update].astype(np.float64) - start
        expected = redone[number].parameters[update] - start
        for name, part in zip(("policy", "value", "variance"), parts, strict=True):
            distance = _distance(found[part], expected[part])
            assert distance < 1e-4, f"after update {update}, {name}: {distance:.2e}"


def test_the_kl_coefficient_follows_the_mean_kl_after_the_last_update(both):
    run, redone, _ = both
    kl = run.config.kl
    betas = [iteration.collect.beta for iteration in run.iterations[1:]] + [run.end.beta]
    for step, (before, after) in zip(redone[1:], pairwise(betas), strict=True):
        factor = 1.0
        if step.kl > 2 * kl.kl_target:
            factor = 1.5
        elif step.kl < 0.5 * kl.kl_target:
            factor = 1 / 1.5
        assert after == pytest.approx(min(max(before * factor, 1 / 35), 35.0), rel=1e-12)


def test_without_psi_the_run_is_plain_dppo_bit_for_bit():
    config = config_of("CartPole-v1")
    runs = [
        train(replace(config, safety=SafetyConfig(variance_critic=critic)))
        for critic in (True, False)
    ]
    safe, plain = (run.end.parameters for run in runs)
    assert len(safe) > len(plain)
    assert safe[: len(plain)].tobytes() == plain.tobytes()
