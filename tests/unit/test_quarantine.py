"""What cannot be believed is refused once, attributed, and judged by what comes out elsewhere."""

import pytest

from dppo.quarantine import Quarantine
from dppo.rounds import RoundId

ROUND, NEXT = RoundId(1, 0, 3), RoundId(1, 0, 4)


def with_usual(size, count=16):
    quarantine = Quarantine()
    for _ in range(count):
        quarantine.accept({"norm": size})
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
    quarantine.accept({"norm": 0.0})
    assert quarantine.outlier({"norm": 1e9}) == ""
    quarantine.accept({"norm": 1.0})
    assert "norm 1e+09, the median of the newest ones is 1" in quarantine.outlier({"norm": 1e9})


def test_a_wild_size_that_is_accepted_does_not_move_the_median():
    quarantine = with_usual(2.0)
    quarantine.accept({"norm": 1e30})
    assert quarantine.outlier({"norm": 1e29})


def test_the_second_refusal_of_a_slot_in_a_round_names_the_first_worker_and_clears_it():
    quarantine = Quarantine()
    assert quarantine.refuse("a", (0, 1), ROUND) is None
    assert quarantine.refuse("b", (2, 3), ROUND) is None
    assert quarantine.refuse("b", (1,), ROUND) == "a"
    for _ in range(2):
        quarantine.refuse("a", (0,), NEXT)
        quarantine.refuse("a", (0,), ROUND)
    assert quarantine.is_benched("a")  # 4 more: the first one was cleared


def test_refusals_of_another_round_do_not_count_as_the_first():
    quarantine = Quarantine()
    assert quarantine.refuse("a", (0,), ROUND) is None
    assert quarantine.refuse("b", (0,), NEXT) is None


def test_the_third_refusal_benches():
    quarantine = Quarantine()
    for update in range(3):
        assert not quarantine.is_benched("a")
        quarantine.refuse("a", (0,), RoundId(1, 0, update))
    assert quarantine.is_benched("a")
