"""Limits that adapt: medians, so that a few outliers move nothing."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dppo.patience import ENOUGH, WINDOW, Patience

seconds = st.floats(0, 1000, allow_subnormal=False)


def noted(*durations, **facts):
    patience = Patience(**{"first": 30.0, "least": 0.5} | facts)
    for duration in durations:
        patience.note(duration)
    return patience


def test_before_eight_durations_are_known_the_first_limit_holds():
    assert noted(*[1.0] * (ENOUGH - 1)).limit == 30
    assert noted(*[1.0] * ENOUGH).limit == 1


def test_the_limit_is_the_median_plus_deviations():
    # median of 1..9 is 5; |x - 5| is 4 3 2 1 0 1 2 3 4, median 2
    patience = noted(*range(1, 10), deviations=3.0)
    assert patience.limit == pytest.approx(5 + 3 * 1.4826 * 2, rel=1e-12)


def test_a_few_outliers_do_not_move_it():
    assert noted(*[2.0] * 9, 500.0, 900.0).limit == 2


def test_it_is_never_below_the_least():
    assert noted(*[0.001] * 20).limit == 0.5


def test_only_the_newest_durations_count():
    patience = noted(*[100.0] * WINDOW, *[2.0] * WINDOW)
    assert patience.limit == 2


def test_the_window_may_be_longer():
    patience = noted(*[100.0] * WINDOW, *[2.0] * (WINDOW - 1), window=2 * WINDOW)
    assert patience.limit == 100


def test_each_doubling_doubles_and_calm_undoes_them():
    patience = noted(*[2.0] * 10)
    patience.double()
    patience.double()
    assert patience.limit == 8
    patience.calm()
    assert patience.limit == 2
    patience.double()
    assert patience.limit == 4


def test_also_the_first_limit_is_doubled():
    patience = noted()
    patience.double()
    assert patience.limit == 60


def test_doublings_end_somewhere():
    patience = noted(*[2.0] * 10)
    for _ in range(2000):
        patience.double()
    assert patience.limit == 2 * 2**16


@settings(deadline=None, max_examples=60)
@given(st.lists(seconds, min_size=ENOUGH, max_size=100))
def test_at_least_half_of_what_was_noted_is_within_the_limit(durations):
    patience = noted(*durations)
    newest = durations[-WINDOW:]
    assert sum(each <= patience.limit for each in newest) * 2 >= len(newest)
