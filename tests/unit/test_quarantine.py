"""What cannot be believed is refused once, attributed, and judged by what comes out elsewhere."""

import pytest

from dppo.quarantine import Quarantine
from dppo.rounds import RoundId

ROUND, NEXT = RoundId(1, 0, 3), RoundId(1, 0, 4)


def with_usual(size, count=16):
    quarantine = Quarantine()
    for _ in range(count):
        quarantine.accept({"norm": size}, (), ROUND)
    return quarantine


@pytest.mark.parametrize(
    ("usual", "size", "is_wild"),
    [
        (5.0, 4.999e6, False),
        (5.0, 5.001e6, True),  # a million times the median
        (1e-6, 0.999e6, False),  # nothing below a million is wild
        (1e-6, 1.001e6, True),
        (5.0, 1e38, True),
    ],
)
def test_a_size_is_wild_at_a_million_times_the_median(usual, size, is_wild):
    assert bool(with_usual(usual).outlier({"norm": size})) == is_wild


def test_nothing_is_wild_before_eight_are_known_and_zeros_say_nothing():
    quarantine = with_usual(1.0, count=7)
    quarantine.accept({"norm": 0.0}, (), ROUND)
    assert quarantine.outlier({"norm": 1e9}) == ""
    quarantine.accept({"norm": 1.0}, (), ROUND)
    assert "norm 1e+09, the median of the newest ones is 1" in quarantine.outlier({"norm": 1e9})


def test_a_wild_size_that_is_accepted_does_not_move_the_median():
    quarantine = with_usual(2.0)
    quarantine.accept({"norm": 1e30}, (), ROUND)
    assert quarantine.outlier({"norm": 1e29})


def test_the_second_refusal_of_a_slot_in_a_round_names_the_first_worker():
    quarantine = Quarantine()
    assert quarantine.refuse("a", (0, 1), ROUND) is None
    assert quarantine.refuse("b", (2, 3), ROUND) is None
    assert quarantine.refuse("b", (1,), ROUND) == "a"
    assert quarantine.refuse("b", (1,), NEXT) is None  # another round, another question


def test_what_is_wild_and_confirmed_is_wild_no_longer():
    quarantine = with_usual(1.0)
    for _ in range(2):
        assert quarantine.outlier({"norm": 1e9})
    quarantine.confirm({"norm": 1e9}, (0,), ROUND)
    assert not quarantine.outlier({"norm": 9e9})
    assert quarantine.outlier({"norm": 1.1e10})


def test_nothing_may_be_larger_than_any_number_that_makes_sense():
    assert Quarantine().outlier({"norm": 1.1e20})


def test_a_worker_is_benched_when_its_third_refused_answer_comes_out_otherwise():
    quarantine = Quarantine()
    for update in range(3):
        round_id = RoundId(1, 0, update)
        quarantine.refuse("a", (0, 1), round_id)
        benched = quarantine.accept({}, (0, 1, 2), round_id)
        assert benched == (["a"] if update == 2 else [])


def test_refusals_that_are_confirmed_or_never_answered_bench_nobody():
    quarantine = Quarantine()
    for update in range(9):
        round_id = RoundId(1, 0, update)
        quarantine.refuse("a", (0,), round_id)
        quarantine.refuse("b", (1,), round_id)
        if update % 2:
            quarantine.confirm({"norm": 1e9}, (0, 1), round_id)
            assert quarantine.accept({"norm": 1e9}, (0, 1), round_id) == []
    assert quarantine.accept({}, (0, 1), NEXT) == []


def test_once_a_part_of_a_refused_answer_is_confirmed_the_rest_refutes_nobody():
    quarantine = Quarantine()
    for update in range(9):
        round_id = RoundId(1, 0, update)
        assert quarantine.refuse("a", (0, 1, 2, 3), round_id) is None
        assert quarantine.refuse("b", (0, 1), round_id) == "a"
        quarantine.confirm({"norm": 1e9}, (0, 1), round_id)
        assert quarantine.accept({"norm": 1e9}, (0, 1), round_id) == []
        assert quarantine.accept({"norm": 1.0}, (2, 3), round_id) == []


def test_what_is_larger_than_any_number_that_makes_sense_counts_once_it_is_confirmed():
    quarantine = with_usual(1.0)
    quarantine.confirm({"norm": 1e22}, (0,), ROUND)
    assert not quarantine.outlier({"norm": 5e22})
    assert quarantine.outlier({"norm": 1.1e23})


def test_failures_of_environments_have_a_memory_of_their_own():
    quarantine = Quarantine()
    assert quarantine.fail("a", 0, RoundId(1, 4, 0)) is None
    assert quarantine.refuse("a", (0,), RoundId(1, 4, 2)) is None
    assert quarantine.fail("b", 0, RoundId(1, 4, 0)) == "a"
    assert quarantine.fail("b", 0, RoundId(1, 5, 0)) is None
