"""Accounting of dropped slots: a function of the ledger's lines and of nothing else."""

import logging

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dppo.config import RolloutConfig
from dppo.store.ledger import IterationLine, LateLine, UpdateLine
from learner.dropping import RECENT, Accounts, Correlation
from learner.ledger import Ledger


def update(*dropped, number=0, iteration=1):
    return UpdateLine(
        iteration=iteration, update=number, dropped=dropped, waited=0.1, parameters="ab"
    )


def iteration(returns=(), lengths=(), number=1):
    return IterationLine(
        iteration=number, parameters_sha256="ab", returns=returns, lengths=lengths
    )


def test_acceptance_is_the_share_of_updates_a_slot_is_in():
    lines = [update(0), update(0, 2), update(), update(2), iteration()]
    late = LateLine(iteration=1, update=0, late=0, by=0.2)
    accounts = Accounts.of(3, [*lines, late])
    assert accounts.figures()["acceptance"] == [0.5, 1.0, 0.5]
    assert accounts.metrics() == {"cluster/acceptance_min": 0.5}
    assert accounts.running == [0, 0, 1]


def test_without_updates_in_the_ledger_there_is_nothing_to_say():
    accounts = Accounts.of(3, [iteration()])
    assert accounts.metrics() == {}
    assert set(accounts.figures().values()) == {None}


def test_the_metric_is_about_the_newest_hundred_updates():
    lines = [update(0)] * RECENT + [update()] * (RECENT - 10) + [update(1)] * 10
    assert Accounts.of(2, lines).metrics()["cluster/acceptance_min"] == pytest.approx(0.9)


def test_a_slot_in_under_half_of_a_hundred_updates_starves_and_is_named_once_per_stretch():
    accounts = Accounts(3)
    named = [accounts.note(update(1) if k % 2 else update()) for k in range(RECENT)]
    assert set(named) == {()}  # in exactly half of them
    assert accounts.note(update(1)) == (1,)  # the oldest of them, without a drop, has left
    assert {accounts.note(update(1)) for _ in range(RECENT)} == {()}
    assert {accounts.note(update()) for _ in range(RECENT)} == {()}
    again = [accounts.note(update(1)) for _ in range(RECENT)]
    assert [each for each in again if each] == [(1,)]


def test_before_a_hundred_updates_nobody_starves():
    accounts = Accounts(2)
    assert {accounts.note(update(0)) for _ in range(RECENT - 1)} == {()}
    assert accounts.note(update(0)) == (0,)


def test_the_correlation_is_over_slots_and_iterations_of_the_share_dropped():
    # iteration 1: slot 0 dropped in 2 of 2 updates, slot 1 in 1, slot 2 in none; 2: slot 1 in all
    accounts = Accounts.of(
        3,
        [
            iteration((7.0, 7.0, 7.0), (7.0, 7.0, 7.0), number=0),  # no updates: does not count
            update(0), update(0, 1), iteration((10.0, 20.0, None), (3.0, 2.0, None)),
            update(1), update(1), iteration((30.0, 10.0, 40.0), (1.0, 3.0, 1.0), number=2),
        ],
    )  # fmt: skip
    shares = [1.0, 0.5, 0.0, 1.0, 0.0]
    figures = accounts.figures()
    for name, values in (
        ("drop_return_correlation", [10.0, 20.0, 30.0, 10.0, 40.0]),
        ("drop_length_correlation", [3.0, 2.0, 1.0, 3.0, 1.0]),
    ):
        assert figures[name] == pytest.approx(np.corrcoef(shares, values)[0, 1], rel=1e-12)
        assert accounts.metrics()[f"cluster/{name}"] == figures[name]


def test_without_any_variation_there_is_no_correlation():
    accounts = Accounts.of(2, [update(), iteration((1.0, 2.0), (1.0, 2.0))])
    assert accounts.figures()["drop_return_correlation"] is None
    assert "cluster/drop_return_correlation" not in accounts.metrics()


@settings(max_examples=60)
@given(st.lists(st.tuples(st.integers(0, 4), st.integers(-1000, 1000)), min_size=2, max_size=30))
def test_the_one_pass_correlation_is_that_of_numpy(pairs):
    found = Correlation()
    for x, y in pairs:
        found.note(x / 4, float(y))
    xs, ys = zip(*pairs, strict=True)
    if len(set(xs)) == 1 or len(set(ys)) == 1:
        assert found.value is None
    else:
        assert found.value == pytest.approx(np.corrcoef(xs, ys)[0, 1], abs=1e-9)


def test_a_resumed_run_goes_on_with_the_accounts_of_its_ledger_and_warns(caplog):
    before = [update(1)] * (RECENT - 1)
    whole: list[object] = []
    ledger = Ledger(RolloutConfig(slots=2, drop=1), whole.append, accounts=Accounts.of(2, before))
    assert ledger.accounts.running == [0, RECENT - 1]
    with caplog.at_level(logging.WARNING, "learner"):
        ledger._note(update(1))
        ledger._note(update(1))
    assert whole == [update(1)] * 2
    (warning,) = caplog.messages
    assert warning.startswith("slot 1 is in fewer than 50 % of the last 100 updates")
