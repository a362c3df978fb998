"""A round takes each slot once, and only for its own question."""

from itertools import permutations, product

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dppo.rounds import Round, RoundId
from dppo.sums import members

NOW = RoundId(2, 7, 3)


def test_closes_when_it_is_overdue_and_all_but_the_droppable_are_in():
    gathered: Round[str] = Round(NOW, range(4), quorum=3, overdue=True)  # W = 4, D = 1
    assert gathered.offer(NOW, (0, 2), "a") == "taken"
    assert not gathered.may_close
    assert gathered.offer(NOW, (3, 1), "b") == "taken"
    assert gathered.may_close
    assert gathered.missing == (2,)
    assert gathered.answers == {(0, 2): "a", (3, 1): "b"}


def test_before_it_is_overdue_it_closes_only_when_all_are_in():
    gathered: Round[str] = Round(NOW, range(4), quorum=1)
    gathered.offer(NOW, (0, 2), "a")
    gathered.offer(NOW, (2, 1), "b")
    assert not gathered.may_close
    gathered.offer(NOW, (3, 1), "c")
    assert gathered.may_close
    gathered = Round(NOW, range(4), quorum=3)
    gathered.offer(NOW, (0, 2), "a")
    gathered.offer(NOW, (2, 1), "b")
    gathered.overdue = True
    assert gathered.may_close


def test_waits_for_the_required_slots_whatever_the_quorum():
    gathered: Round[str] = Round(NOW, range(4), quorum=2, required=frozenset({3}), overdue=True)
    gathered.offer(NOW, (0, 2), "a")
    assert not gathered.may_close
    gathered.offer(NOW, (3, 1), "b")
    assert gathered.may_close
    assert gathered.missing == (2,)


def test_takes_what_comes_after_the_quorum():
    gathered: Round[str] = Round(NOW, range(2), quorum=1)
    gathered.offer(NOW, (0, 1), "a")
    assert gathered.offer(NOW, (1, 1), "b") == "taken"
    assert gathered.missing == ()


def test_an_answer_to_another_question_is_stale():
    gathered: Round[str] = Round(NOW, range(2), quorum=2)
    for other in (RoundId(1, 7, 3), RoundId(3, 7, 3), RoundId(2, 6, 3), RoundId(2, 7, 4)):
        assert gathered.offer(other, (0, 1), "old") == "stale"
    assert gathered.answers == {}
    assert gathered.missing == (0, 1)


def test_the_first_answer_of_a_slot_stays():
    gathered: Round[str] = Round(NOW, range(2), quorum=2)
    gathered.offer(NOW, (0, 1), "first")
    assert gathered.offer(NOW, (0, 1), "second") == "repeated"
    assert gathered.answers == {(0, 1): "first"}
    gathered.overdue = True
    assert not gathered.may_close


def test_a_block_that_repeats_one_slot_is_ignored_whole():
    gathered: Round[str] = Round(NOW, range(8), quorum=8)
    gathered.offer(NOW, (2, 1), "one")
    assert gathered.offer(NOW, (0, 4), "four, with slot 2 again") == "repeated"
    assert gathered.missing == (0, 1, 3, 4, 5, 6, 7)
    assert gathered.offer(NOW, (4, 4), "the others") == "taken"


def test_slots_nobody_asked_for_are_ignored():
    gathered: Round[str] = Round(NOW, (0, 2), quorum=1)
    assert gathered.offer(NOW, (1, 1), "not asked") == "repeated"
    assert gathered.offer(NOW, (0, 2), "half not asked") == "repeated"
    gathered.overdue = True
    assert not gathered.may_close


def test_round_ids_are_ordered_by_generation_then_iteration_then_step():
    assert RoundId(1, 9, 9) < RoundId(2, 0, 0) < RoundId(2, 0, 1) < RoundId(2, 1, 0)


EVENTS = ("0 of this", "1 of this", "2 of this", "0 and 1 of this", "2 of an older", "overdue")


@pytest.mark.parametrize(("drop", "required"), list(product((0, 1, 2), ((), (2,), (0, 2)))))
def test_in_every_order_of_events_it_may_close_exactly_when_the_rule_says_so(drop, required):
    """All orders of up to six events, among them an answer in parts, repeated, and out of date."""
    for length in range(len(EVENTS) + 1):
        for order in permutations(EVENTS, length):
            gathered: Round[str] = Round(NOW, range(3), 3 - drop, required=frozenset(required))
            held: set[int] = set()
            closable = False
            for event in order:
                if event == "overdue":
                    gathered.overdue = True
                elif event == "2 of an older":
                    assert gathered.offer(RoundId(2, 7, 2), (2, 1), event) == "stale"
                else:
                    block = (0, 2) if "and" in event else (int(event[0]), 1)
                    fresh = held.isdisjoint(members(block))
                    taken = gathered.offer(NOW, block, event)
                    assert taken == ("taken" if fresh else "repeated")
                    held |= set(members(block)) if fresh else set()
                over = "overdue" in order[: order.index(event) + 1]
                rule = len(held) == 3 or (
                    over and len(held) >= 3 - drop and held.issuperset(required)
                )
                assert gathered.may_close == rule, order
                assert rule or not closable, f"{order}: what may close stays so"
                closable = rule
                assert set(gathered.missing) == {0, 1, 2} - held


blocks = st.integers(0, 3).flatmap(
    lambda power: st.tuples(
        st.integers(0, 16 // 2**power).map(lambda k: k * 2**power), st.just(2**power)
    )
)


@settings(deadline=None, max_examples=50)
@given(st.lists(blocks, max_size=30), st.integers(0, 15))
def test_no_slot_ever_counts_twice(offers, drop):
    gathered: Round[int] = Round(NOW, range(16), quorum=16 - drop, overdue=True)
    for number, block in enumerate(offers):
        fits = set(members(block)) <= set(gathered.missing)
        assert gathered.offer(NOW, block, number) == ("taken" if fits else "repeated")
        held = [slot for taken in gathered.answers for slot in members(taken)]
        assert sorted([*held, *gathered.missing]) == list(range(16))
        assert gathered.may_close == (len(held) >= 16 - drop)
