"""Figures of an arm: by hand where they can be, and the sentences that follow from them."""

from dataclasses import replace

import numpy as np
import pytest

from dppo.four_rooms.agent import Outcome, Trial
from dppo.four_rooms.experiment import Collector, ablations, psi_sweep, table_1, trials_of
from dppo.four_rooms.oracle import evaluate
from dppo.four_rooms.rollouts import visits, walk
from dppo.four_rooms.settings import AgentConfig
from dppo.four_rooms.summary import Bootstrap, compare, curve, episodes_to, summarise
from dppo.four_rooms.verdicts import claims
from dppo.four_rooms.world import World

WORLD = World()
SAFE = AgentConfig()
ARMS = table_1(SAFE, 0.1)


def outcome(agent, number, returns, frozen=0):
    """A trial that ended with the uniform policy."""
    count = len(returns)
    return Outcome(
        trial=Trial(agent, number),
        policy=WORLD.mdp.uniform,
        q=np.zeros((104, 4)),
        sigma=np.zeros((104, 4)),
        returns=np.array(returns, np.float64),
        lengths=np.full(count, 500, np.int16),
        frozen=np.full(count, frozen, np.int16),
    )


def gathered(*arms):
    """Arms with these returns, trial by trial, and frozen steps."""
    collector = Collector(ARMS, 2)
    for arm, (trials, frozen) in zip(ARMS, arms, strict=True):
        for number, returns in enumerate(trials):
            collector.add(outcome(arm.agent, number, returns, frozen))
    return collector.finished()


def test_table_1_has_its_two_arms():
    plain, safe = (arm.agent for arm in ARMS)
    assert (plain.psi, plain.alpha_theta, plain.alpha_critic) == (0.0, 0.01, 0.1)
    assert (safe.psi, safe.alpha_theta, safe.alpha_critic, safe.alpha_sigma) == (
        0.25, 0.01, 0.25, 0.01,
    )  # fmt: skip
    assert {(one.gamma, one.lambda_ret, one.temperature) for one in (plain, safe)} == {
        (0.99, 0.99, 0.05)
    }


def test_an_agent_that_belongs_to_several_arms_runs_once():
    arms = [*ARMS, *psi_sweep(SAFE), *ablations(SAFE, 0.1)]
    # 2 of table 1, 5 of the sweep with the safe arm among them, 5 changes of 2, and the safe arm
    # with the plain arm's α_c; the plain arm with the safe arm's is in the sweep
    assert len({arm.key for arm in arms}) == len(arms) == 19
    assert len(trials_of(arms, 3)) == 3 * (2 + 4 + 10 + 1)


def test_an_arm_counts_once_all_its_trials_are_there():
    collector = Collector(ARMS, 2)
    plain, safe = (arm.agent for arm in ARMS)
    assert collector.add(outcome(safe, 1, [0.0])) == []
    assert collector.add(outcome(plain, 0, [0.0])) == []
    assert collector.finished() == []
    assert [arm.key for arm in collector.add(outcome(safe, 0, [0.0]))] == ["safe"]
    assert [one.arm.key for one in collector.finished()] == ["safe"]


def test_the_figures_of_two_trials_of_two_episodes():
    plain, _ = gathered(([[0.0, 10.0], [20.0, 50.0]], 3), ([[0.0, 0.0]] * 2, 0))
    found = summarise(plain, WORLD.mdp, Bootstrap(2, 0))
    assert found["return_mean"] == 20.0
    # episode by episode: 0 and 20 have std 10, 10 and 50 have std 20
    assert found["return_std_across_trials"] == 15.0
    # trial by trial: 0 and 10 have std 5, 20 and 50 have std 15
    assert found["return_std_within"] == 10.0
    assert found["return_std_of_trial_means"] == 15.0  # of 5 and 35
    assert found["frozen_steps_per_episode"] == 3.0
    assert found["timeouts_fraction"] == 1.0
    assert found["intervals_95"]["return_mean"] == [5.0, 35.0]


def test_the_exact_value_of_a_policy_is_the_oracles():
    plain, _ = gathered(([[0.0], [0.0]], 0), ([[0.0]] * 2, 0))
    found = summarise(plain, WORLD.mdp, Bootstrap(2, 0))
    by_trace = [evaluate(WORLD.mdp, WORLD.mdp.uniform, 0.99, trace) for trace in (0.99, 1.0)]
    start = WORLD.mdp.start
    assert found["exact_value_mean"] == start @ by_trace[0].v
    assert found["exact_sigma_mean"] == start @ by_trace[0].sigma
    assert found["exact_sigma_full_return_mean"] == start @ by_trace[1].sigma


def test_arms_are_compared_by_a_difference_and_two_ratios():
    plain, safe = gathered(([[0.0, 0.0], [20.0, 20.0]], 10), ([[28.0, 28.0], [32.0, 32.0]], 1))
    found = compare(plain, safe, Bootstrap(2, 0))
    assert found["return_difference"] == 20.0
    assert found["return_std_ratio"] == 0.2
    assert found["frozen_steps_ratio"] == 0.1
    # trial k of both arms is resampled together: 28 - 0 or 32 - 20, or one of each
    assert found["intervals_95"]["return_difference"] == [12.0, 28.0]


def test_an_interval_covers_the_mean_of_its_values_and_repeats():
    values = np.arange(50.0)
    low, high = Bootstrap.interval(Bootstrap(50, 0).means(values))
    # standard error: 14.43 / sqrt(50) = 2.04, so about 24.5 ± 4
    assert 19.5 < low < 21.5
    assert 27.5 < high < 29.5
    assert Bootstrap.interval(Bootstrap(50, 0).means(values)) == [low, high]


def test_the_spread_of_a_resample_is_not_biased():
    returns = np.random.default_rng(0).normal(0, 10, (50, 200))
    spreads = Bootstrap(50, 0).spreads(returns)
    assert spreads.mean() == pytest.approx(returns.std(axis=0).mean(), rel=0.01)


def test_a_curve_has_one_point_for_20_episodes():
    returns = np.arange(45.0).repeat(2).reshape(45, 2).T  # two equal trials, 45 episodes
    episode, mean, std = curve(returns)
    assert episode.tolist() == [10.5, 30.5]  # 1 to 20, 21 to 40; the rest is too short
    assert mean.tolist() == [9.5, 29.5]
    assert std.tolist() == [0.0, 0.0]


def test_a_level_is_reached_when_it_is_never_left_again():
    steps = [0.0, 40.0, 0.0, 40.0, 40.0]
    assert episodes_to(30.0, np.repeat(steps, 20)) == 60
    assert episodes_to(30.0, np.full(40, 31.0)) == 0
    assert episodes_to(30.0, np.repeat([40.0, 0.0], 20)) is None


def story(gain, spread, ice):
    """Verdicts for intervals of difference and ratios."""
    test = {"frozen_time_share": 0.0, "episodes_touching_ice": 0.0}
    arm = {
        "return_mean": 0.0, "return_std_across_trials": 0.0, "episodes_to_good_return": None,
        "frozen_steps_per_episode": 0.0, "test": test,
    }  # fmt: skip
    names = ("return_difference", "return_std_ratio", "frozen_steps_ratio")
    results = {
        "arms": [arm | {"key": "plain"}, arm | {"key": "safe"}],
        "comparison": dict.fromkeys(names, 0.0)
        | {"intervals_95": dict(zip(names, (gain, spread, ice), strict=True))},
        "optimum": [
            {"key": key, "learned_cells_onto_ice": 0.0, "test": test} for key in ("plain", "safe")
        ],
    }
    better, smaller, _, drier, *_ = (verdict for _, _, verdict in claims(results))
    return better, smaller, drier


def test_a_verdict_follows_from_its_interval():
    assert story((1, 2), (0.2, 0.4), (0.0, 0.1)) == ("holds",) * 3
    assert story((-2, -1), (1.2, 1.4), (2.0, 3.0)) == ("does not hold",) * 3
    assert story((-1, 1), (0.9, 1.1), (0.5, 2.0)) == ("not decided by these trials",) * 3


def test_test_episodes_visit_every_cell_under_the_uniform_policy():
    found = visits(WORLD, [WORLD.mdp.uniform] * 2, seed=0, episodes=10)
    assert found.share.sum() == pytest.approx(1)
    assert found.share[WORLD.goal] == 0
    assert (np.delete(found.share, WORLD.goal) > 0).all()
    assert 0.5 < found.touching <= 1


def test_a_walk_goes_from_cell_to_neighbouring_cell_until_the_goal():
    policy = np.eye(4)[[np.argmin(abs(WORLD.ways[cell] - cell)) for cell in range(104)]]
    policy = (policy + 3 * WORLD.mdp.uniform) / 4
    cells = walk(WORLD, policy, start=0, seed=0, number=0)
    steps = abs(np.diff(WORLD.cells[cells], axis=0)).sum(axis=1)
    assert set(steps.tolist()) <= {0, 1}
    assert cells[0] == 0
    assert cells[-1] == WORLD.goal or len(cells) == 501


def test_changes_are_made_to_both_arms():
    changed = {arm.key: arm.agent for arm in ablations(SAFE, 0.1)}
    plain = replace(SAFE, psi=0.0, alpha_critic=0.1)
    assert changed["safe, printed"] == replace(SAFE, update="printed")
    assert changed["plain, printed"] == replace(plain, update="printed")
    assert changed["safe, equal α_c"] == replace(SAFE, alpha_critic=0.1)
    assert changed["plain, equal α_c"] == replace(plain, alpha_critic=0.25)
