"""What the chief moves from one iteration to the next, and when it stops the policy's updates."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from dppo.gradients import Sums
from dppo.wire.messages import Collect, Collected, Gradient, Measure, Measured, Update
from tests.golden.recorded_run import ITERATIONS, PSI, SLOTS, UPDATES, config_of, train

CONFIG = config_of("CartPole-v1")
RATE = 0.02
"""Of the dual steps; low enough that psi stays above 0."""


def run_with(**groups):
    """A small run with other settings: group to name to value."""
    changed = {name: replace(getattr(CONFIG, name), **new) for name, new in groups.items()}
    return train(replace(CONFIG, **changed))


def sent(run, kind, iteration):
    return [m for m in run.link.sent if isinstance(m, kind) and m.iteration == iteration]


def received(run, kind, iteration):
    return [m for m in run.link.received if isinstance(m, kind) and m.iteration == iteration]


def collects(run):
    return [sent(run, Collect, iteration)[0] for iteration in range(ITERATIONS)]


def mean_kls(run, iteration):
    """[updates] of all slots together, before each update."""
    gradients = received(run, Gradient, iteration)
    rounds = [[g.sums for g in gradients if g.round == 1 + update] for update in range(UPDATES)]
    return [Sums.from_vector(np.sum(sums, axis=0)).mean_kl for sums in rounds]


def moves(run, iteration):
    """Network to whether each of the iteration's updates has moved it."""
    asked = sent(run, Update, iteration) + sent(run, Measure, iteration)
    return {
        name: [
            bool((before.parameters[part] != after.parameters[part]).any())
            for before, after in pairwise(asked)
        ]
        for name, part in run.networks.parts.items()
    }


def test_above_kl_stop_the_policy_stands_still_for_the_iteration_and_the_critics_go_on():
    """The limit lies between the KL before the second and before the third of four updates."""
    free = run_with(kl={"kl_stop": math.inf})
    assert moves(free, 1) == dict.fromkeys(free.networks.parts, [True] * 4)
    kls = mean_kls(free, 1)
    assert kls[0] < kls[1] < kls[2]
    limit = (kls[1] + kls[2]) / 2
    run = run_with(kl={"kl_stop": limit / CONFIG.kl.kl_target})
    still, goes_on = [True, True, False, False], [True] * 4
    assert moves(run, 1) == {"policy": still, "value": goes_on, "variance": goes_on}
    everybody = tuple(range(SLOTS))
    assert [update.stopped for update in sent(run, Update, 1)] == [(), (), (), everybody]
    assert [r.reports[1].metrics["train/policy_updates"] for r in (run, free)] == [2.0, 4.0]
    assert sent(run, Update, 2)[0].stopped == ()
    assert moves(run, 2)["policy"][0]


@pytest.mark.parametrize(
    ("schedule", "expected"),
    [("constant", [0.4] * 4), ("linear", [0.0, 0.1, 0.2, 0.3]), ("warmup", [0.0, 0.0, 0.0, 0.2])],
)
def test_psi_follows_its_schedule_from_iteration_to_iteration(schedule, expected):
    """At a quarter, a half and three quarters of the run; the warm-up is its first half."""
    run = run_with(safety={"psi": 0.4, "psi_schedule": schedule, "psi_warmup": 0.5})
    assert [collect.psi for collect in collects(run)] == pytest.approx(expected, rel=1e-12)
    told = [report.metrics["safety/psi"] for report in run.reports]
    assert told == [collect.psi for collect in collects(run)]


def test_the_policys_standard_deviation_is_told_as_it_is_after_the_updates():
    run = train(config_of("Hopper-v5"))
    for iteration, report in list(enumerate(run.reports))[:-1]:
        _, log_std = run.networks.split_policy(sent(run, Collect, iteration + 1)[0].parameters)
        assert report.metrics["train/std"] == pytest.approx(float(np.exp(log_std).mean()))
    assert run.reports[0].metrics["train/std"] != run.reports[1].metrics["train/std"]


def test_the_mean_reward_is_that_of_all_steps_of_the_iteration_before():
    run = train(config_of("Hopper-v5"))
    expected = [
        np.mean([answer.reward[1] for answer in received(run, Collected, iteration)])
        for iteration in range(ITERATIONS - 1)
    ]
    told = [collect.mean_reward for collect in collects(run)]
    assert told == pytest.approx([0.0, *expected])
    assert len(set(told)) == ITERATIONS


def start_sigma(run, iteration):
    """Mean of sigma(s_0) over all episodes that began in the iteration."""
    counts, means, _ = np.array([m.start_sigma for m in received(run, Collected, iteration)]).T
    return np.average(means, weights=counts)


@pytest.mark.parametrize(("share", "step"), [(0.5, RATE), (2.0, -RATE / 2)])
def test_psi_goes_up_while_sigma_is_above_its_limit_and_down_below(share, step):
    """At a limit of half of sigma the violation is 1, at twice of it -1/2."""
    free = run_with()
    limit = share * start_sigma(free, 1)
    run = run_with(safety={"variance_limit": limit, "variance_limit_rate": RATE})
    psis = [collect.psi for collect in collects(run)] + [run.end.psi]
    assert psis[:2] == [PSI, PSI]  # the first iteration adapts nothing
    assert psis[2] - psis[1] == pytest.approx(step)
    steps = [RATE * (start_sigma(run, iteration) / limit - 1) for iteration in (2, 3)]
    assert np.diff(psis)[2:] == pytest.approx(steps)


@pytest.mark.parametrize(("scope", "factor"), [("worker", 1.125), ("chief", 1.5)])
def test_beta_moves_once_by_the_mean_kl_or_a_little_by_that_of_each_slot(scope, factor):
    """One slot is below the band, one in it, two above: 1.125 x 1.125 / 1.125, α~ = 1 + 0.5 / 4.

    Their mean is above it, too.
    """
    free = run_with(kl={"kl_scope": scope})
    kls = sorted(kl for m in received(free, Measured, 1) for kl in (m.kls / m.weights).tolist())
    low, high = (kls[0] + kls[1]) / 2, (kls[1] + kls[2]) / 2
    assert np.mean(kls) > high
    band = {"kl_low": low / CONFIG.kl.kl_target, "kl_high": high / CONFIG.kl.kl_target}
    run = run_with(kl={"kl_scope": scope, **band})
    betas = [collect.beta for collect in collects(run)]
    assert betas[:2] == [1.0, 1.0]
    assert betas[2] == pytest.approx(factor, rel=1e-12)
    assert [report.metrics["train/kl_coef"] for report in run.reports[:3]] == betas[1:]
