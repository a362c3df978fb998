"""When an update goes on without the late ones, and without whom it never does."""

import math
from itertools import product

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dppo.deadlines import Deadlines, Late
from dppo.rounds import Round, RoundId

ALL = (0, 1, 2, 3)


def asked(number, drop=1, iteration=1):
    """Update `number` of four slots."""
    return Round[str](RoundId(1, iteration, number), ALL, quorum=4 - drop)


def answer(deadlines, round_, slot, now):
    deadlines.answered(round_.id, (slot, 1), now)
    round_.offer(round_.id, (slot, 1), "gradient")


def update(deadlines, number, seconds, now=0.0, drop=1):
    """One whole update: each slot after so many seconds, None: not at all; it closes after 60."""
    round_ = asked(number, drop)
    deadline = deadlines.open(round_, now)
    for slot, after in enumerate(seconds):
        if after is not None:
            answer(deadlines, round_, slot, now + after)
    deadlines.close(round_, now + 60)
    return round_, deadline


def test_before_eight_answers_are_known_it_waits_for_half_a_minute():
    deadlines = Deadlines(4, drop_limit=8)
    assert deadlines.open(asked(1), now=100.0) == 130
    round_, deadline = update(deadlines, 2, [1, 1, 1, 1], now=200.0)
    assert deadline == 230
    assert round_.waited == 60


def test_then_until_the_median_plus_five_deviations():
    deadlines = Deadlines(4, drop_limit=8)
    update(deadlines, 1, [1, 2, 3, 4])
    update(deadlines, 2, [1, 2, 3, 4])
    # the median of 1 1 2 2 3 3 4 4 is 2.5; its distances are 1.5 1.5 .5 .5 .5 .5 1.5 1.5: median 1
    expected = 500 + 2.5 + 5 * 1.4826 * 1
    assert deadlines.open(asked(3), now=500.0) == pytest.approx(expected, rel=1e-12)


def test_a_late_answer_counts_with_how_long_it_took_and_is_reported_once():
    deadlines = Deadlines(4, drop_limit=8)
    first, _ = update(deadlines, 1, [1, 1, 1, None])  # closes at 60
    second, _ = update(deadlines, 2, [1, 1, 1, None], now=61)
    assert deadlines.take_late() == []
    deadlines.answered(first.id, (3, 1), now=75.0)
    deadlines.answered(first.id, (3, 1), now=76.0)  # repeated
    assert deadlines.take_late() == [Late(first.id, 3, by=15.0)]
    assert deadlines.take_late() == []
    deadlines.answered(second.id, (3, 1), now=121.0)  # at the very moment that it closed
    assert deadlines.take_late() == [Late(second.id, 3, by=0.0)]
    # 1 1 1 1 1 1 60 75: the median of the distances is 0, so it waits for the median, 1
    assert deadlines.open(asked(3), now=0.0) == 1


def test_half_of_the_answers_late_move_the_deadline_to_them():
    deadlines = Deadlines(4, drop_limit=8)
    for number in range(1, 5):
        round_, _ = update(deadlines, number, [1, 1, None, None], drop=2)
        deadlines.answered(round_.id, (2, 2), now=90.0)
    assert deadlines.open(asked(9), now=0.0) > 90


def test_a_slot_that_was_dropped_often_enough_is_required_until_it_is_in_again():
    deadlines = Deadlines(4, drop_limit=3)
    for number in (1, 2, 3):
        round_, _ = update(deadlines, number, [1, 1, 1, None])
        assert round_.required == frozenset()
    round_, _ = update(deadlines, 4, [1, 1, None, 1])
    assert round_.required == {3}
    round_, _ = update(deadlines, 5, [1, 1, 1, 1])
    assert round_.required == frozenset()
    assert deadlines.running == {0: 0, 1: 0, 2: 0, 3: 0}


def test_a_late_answer_does_not_end_a_row_of_drops():
    deadlines = Deadlines(4, drop_limit=2)
    for number in (1, 2):
        round_, _ = update(deadlines, number, [1, 1, 1, None])
        deadlines.answered(round_.id, (3, 1), now=61.0)
    assert update(deadlines, 3, [1, 1, 1, 1])[0].required == {3}


def test_with_a_limit_of_0_nobody_is_ever_dropped():
    round_ = asked(1)
    Deadlines(4, drop_limit=0).open(round_, now=0.0)
    assert round_.required == set(ALL)


def test_a_round_that_needs_all_slots_has_no_deadline_and_says_nothing():
    deadlines = Deadlines(4, drop_limit=8)
    round_, deadline = update(deadlines, 1, [1, 1, 1, None], drop=0)
    assert deadline == math.inf
    assert (round_.required, deadlines.running[3]) == (frozenset(), 0)
    deadlines.answered(round_.id, (3, 1), now=100.0)
    assert deadlines.take_late() == []


def test_answers_to_rounds_of_an_earlier_iteration_say_nothing():
    deadlines = Deadlines(4, drop_limit=8)
    round_, _ = update(deadlines, 1, [1, 1, 1, None])
    deadlines.open(asked(1, iteration=2), now=100.0)
    deadlines.answered(round_.id, (3, 1), now=101.0)
    assert deadlines.take_late() == []


def test_the_window_holds_whole_updates_also_of_many_slots():
    deadlines = Deadlines(100, drop_limit=8)
    for number in range(1, 4):
        round_ = Round[str](RoundId(1, 1, number), range(100), quorum=99)
        deadlines.open(round_, now=0.0)
        for slot in range(100):
            deadlines.answered(round_.id, (slot, 1), now=1.0 if slot < 60 else 2.0)
    # 60 % took 1 s: a window that began with the last 64 answers would have a median of 2 s
    assert deadlines.open(asked(9), now=0.0) == 1


@pytest.mark.parametrize("limit", [1, 2, 3])
def test_in_every_order_of_drops_no_slot_is_dropped_more_often_running(limit):
    """All ways in which two of three slots may be late in seven updates; late ones are dropped
    unless they are required.
    """
    for lateness in product(((), (1,), (2,), (1, 2)), repeat=6):
        deadlines, running = Deadlines(3, drop_limit=limit), {1: 0, 2: 0}
        for number, late in enumerate(lateness, start=1):
            round_ = Round[str](RoundId(1, 1, number), range(3), quorum=1, overdue=True)
            deadlines.open(round_, now=0.0)
            for slot in range(3):
                if slot not in late:
                    answer(deadlines, round_, slot, 0.1)
            for slot in sorted(set(late) & round_.required):
                assert not round_.may_close
                answer(deadlines, round_, slot, 0.2)
            assert round_.may_close
            deadlines.close(round_, 0.3)
            for slot in running:
                running[slot] = running[slot] + 1 if slot in round_.missing else 0
                assert running[slot] == deadlines.running[slot] <= limit


@settings(max_examples=60)
@given(st.lists(st.tuples(st.integers(1, 6), st.integers(0, 3), st.floats(0, 50)), max_size=60))
def test_whatever_comes_each_slot_is_late_at_most_once_a_round_and_never_early(events):
    deadlines, opened = Deadlines(4, drop_limit=2), 0
    rounds: list[Round[str]] = []
    for number, slot, seconds in events:
        if number > opened:
            opened += 1
            rounds.append(
                update(deadlines, opened, [1, 1, None, None], now=100 * opened, drop=2)[0]
            )
        round_ = rounds[min(number, opened) - 1]
        deadlines.answered(round_.id, (slot, 1), now=100 * round_.id.round + 60 + seconds)
    late = deadlines.take_late()
    assert len({(each.id, each.slot) for each in late}) == len(late)
    assert all(each.by >= 0 and each.slot in (2, 3) for each in late)
