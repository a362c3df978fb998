"""What weather does to bytes: their time, their order, their bits. Times are worked out here."""

import random

import pytest

from dppo.chaos.plan import LINK_KINDS
from dppo.chaos.weather import DIRECTIONS, Lane, Weather

CLEAR = Weather()


class Always(random.Random):
    """Dice that always fall on the same number."""

    def __init__(self, number):
        super().__init__(0)
        self.number = number

    def random(self):
        return self.number


def passed(lane, now, weather):
    """All bytes that have arrived, taken one by one."""
    out = b""
    while (data := lane.due(now, weather)) is not None:
        out += bytes(data[:1])
        lane.taken(1)
    return out


def test_on_a_clear_link_bytes_arrive_at_once_and_in_order():
    lane = Lane(Always(0.0))
    lane.put(b"ab", 5.0, CLEAR)
    lane.put(b"c", 5.0, CLEAR)
    assert lane.held == 3
    assert passed(lane, 5.0, CLEAR) == b"abc"
    assert lane.held == 0


def test_a_delay_holds_every_byte_for_as_long():
    lane, weather = Lane(Always(0.5)), Weather(delay=0.25)
    lane.put(b"a", 1.0, weather)
    lane.put(b"b", 2.0, weather)
    assert lane.next_arrival(weather) == 1.25
    assert passed(lane, 1.24, weather) == b""
    assert passed(lane, 1.25, weather) == b"a"
    assert passed(lane, 2.25, weather) == b"b"


def test_a_slow_link_takes_time_per_byte_one_chunk_after_the_other():
    lane, weather = Lane(Always(0.5)), Weather(bytes_per_second=4.0)
    lane.put(b"ab", 0.0, weather)
    lane.put(b"cd", 0.0, weather)
    assert passed(lane, 0.5, weather) == b"ab"
    assert passed(lane, 0.99, weather) == b""
    assert passed(lane, 1.0, weather) == b"cd"


def test_what_is_lost_comes_later_and_what_follows_waits_for_it():
    dice = Always(0.1)
    lane, weather = Lane(dice), Weather(loss=0.2)
    lane.put(b"lost", 0.0, weather)
    dice.number = 0.2
    lane.put(b"not", 0.0, weather)
    assert passed(lane, 0.19, weather) == b""
    assert passed(lane, 0.2, weather) == b"lostnot"


def test_while_a_link_is_blocked_nothing_passes_and_all_of_it_comes_later():
    lane, blocked = Lane(Always(0.5)), Weather(blocked=True)
    lane.put(b"ab", 0.0, CLEAR)
    assert passed(lane, 9.0, blocked) == b""
    assert lane.next_arrival(blocked) == float("inf")
    assert passed(lane, 9.0, CLEAR) == b"ab"


def test_corruption_turns_over_one_bit_of_a_chunk():
    lane, weather = Lane(Always(0.1)), Weather(corrupt=0.2)
    data = bytes(range(64))
    lane.put(data, 0.0, weather)
    altered = passed(lane, 0.0, weather)
    assert len(altered) == len(data)
    assert sum((one ^ other).bit_count() for one, other in zip(data, altered, strict=True)) == 1


@pytest.mark.parametrize("direction", DIRECTIONS)
def test_faults_of_one_direction_leave_the_other_alone(direction):
    (other,) = set(DIRECTIONS) - {direction}
    kinds = {f"partition-{direction}", f"corrupt-{direction}"}
    assert Weather.of(kinds, direction).blocked
    assert Weather.of(kinds, direction).corrupt > 0
    assert Weather.of(kinds, other) == CLEAR


@pytest.mark.parametrize("kind", [kind for kind in LINK_KINDS if kind != "disconnect"])
def test_every_kind_of_link_fault_changes_a_direction(kind):
    assert any(Weather.of({kind}, direction) != CLEAR for direction in DIRECTIONS)


def test_faults_add_up():
    weather = Weather.of({"delay", "slow", "loss", "partition"}, "to-worker")
    assert weather == Weather(
        delay=0.2, bytes_per_second=125_000.0, loss=0.2, corrupt=0.0, blocked=True
    )
