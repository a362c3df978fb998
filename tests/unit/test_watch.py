"""Who stalls and who is only slow; how fast each one is."""

import pytest

from dppo.pace import Pace
from dppo.patience import Patience
from dppo.watch import Watch

PULSE = 2.0
FOUR = (0, 1, 2, 3)


def watch(first=2.0, least=1.0):
    return Watch(Patience(first=first, least=least), Patience(first=PULSE, least=PULSE))


def test_a_worker_stalls_when_it_owes_an_answer_and_its_count_stands_still():
    w = watch()
    for now in (0.0, 0.5, 1.0, 1.5, 2.0):
        w.hear("a", now, done=7)
        assert w.look(now, ["a"]) == []
    w.hear("a", 2.5, done=7)
    assert w.look(2.5, ["a"]) == ["a"]
    assert w.describe("a", 2.5) == "alive but without progress for 2.5 s"


def test_a_worker_whose_last_sign_of_life_is_a_little_late_is_not_called_silent():
    w = watch(first=1.0)
    for now in (0.0, 0.5):
        w.hear("a", now, done=7)
    assert w.describe("a", 1.1) == "alive but without progress for 1.1 s"


def test_a_worker_of_which_nothing_is_heard_stalls_sooner_than_one_that_lives():
    w = watch(first=60.0)
    w.hear("a", 0.0, done=1)
    w.hear("b", 0.0, done=1)
    for now in (1.0, 2.0, 3.0):
        w.hear("a", now, done=1)
    assert w.look(3.0, ["a", "b"]) == ["b"]
    assert w.describe("b", 3.0) == "silent for 3.0 s"


def test_a_count_that_grows_and_an_answer_are_progress():
    w = watch()
    w.hear("a", 0.0, done=1)
    w.hear("a", 1.9, done=2)
    w.hear("a", 3.8)
    assert w.look(7.5, ["a"]) == []  # twice 1.9 s, which ended well
    assert w.look(7.7, ["a"]) == ["a"]
    assert w.describe("a", 7.7) == "silent for 3.9 s"


def test_silence_counts_from_when_the_worker_began_to_owe():
    w = watch()
    w.hear("a", 0.0, done=1)
    assert w.look(100.0, []) == []
    assert w.look(101.9, ["a"]) == []
    assert w.look(102.1, ["a"]) == ["a"]


def test_of_two_workers_only_the_one_that_stalls_is_named_and_forgotten_ones_start_anew():
    w = watch()
    w.hear("a", 0.0)
    w.hear("b", 2.0)
    assert w.look(2.5, ["a", "b"]) == ["a"]
    w.forget("a")
    assert w.look(2.6, ["a", "b"]) == []


def test_the_limit_follows_the_silences_seen_and_doubles_when_someone_was_given_up():
    w = watch(first=60.0, least=1.0)
    for k in range(9):
        w.hear("a", 4.0 * k, done=k)  # always 4 s apart: no deviation
    assert (w.patience.limit, w.pulse.limit) == (4.0, 4.0)
    assert w.look(39.8, ["a"]) == []  # twice the longest
    assert w.look(40.1, ["a"]) == ["a"]
    assert (w.patience.limit, w.pulse.limit) == (8.0, 8.0)
    w.calm()
    assert (w.patience.limit, w.pulse.limit) == (4.0, 4.0)


def test_pace_is_the_median_of_the_newest_collections_per_slot():
    pace = Pace()
    for seconds in (9.0, 8.0, 1.0, 2.0, 3.0, 100.0, 3.0):  # the first two are forgotten
        pace.begin("a", FOUR, now=10.0)
        pace.end("a", now=10.0 + seconds)
    assert pace.seconds_per_slot == {"a": 3.0 / 4}


def test_a_collection_of_new_slots_does_not_count_they_had_to_be_set_up():
    pace = Pace()
    for slots, seconds in ((FOUR, 50.0), (FOUR, 4.0), ((0, 1), 30.0), ((0, 1), 2.0)):
        pace.begin("a", slots, now=0.0)
        pace.end("a", now=seconds)
    assert pace.seconds_per_slot == {"a": 1.0}


def test_what_was_never_done_is_waited_for_as_long_as_at_first():
    w = watch(first=60.0, least=1.0)
    for k in range(20):
        w.hear("a", 0.5 * k, done=k)
    w.is_new = True
    for now in range(10, 70):
        w.hear("a", float(now), done=19)
        assert w.look(float(now), ["a"]) == []
    w.hear("a", 70.0, done=19)
    assert w.look(70.0, ["a"]) == ["a"]


@pytest.mark.parametrize(("workers", "rollout", "update"), [(8, 60, 4), (32, 16, 4), (2, 300, 5)])
def test_long_rollouts_of_many_do_not_make_their_long_gradients_stalls(workers, rollout, update):
    """In a rollout the counts grow at each sign of life, in a gradient they stand still."""
    w = Watch(Patience(first=30.0, least=3.0), Patience(first=3.0, least=3.0))
    names, now, done = [f"w{k}" for k in range(workers)], 0.0, 0
    for iteration in range(6):
        for seconds, moves in ((rollout, True), (update, False)):
            w.is_new = iteration == 0
            for tick in range(2 * seconds):
                now, done = now + 0.5, done + (moves or tick == 0)
                for name in names:
                    w.hear(name, now, done)
                assert w.look(now, names) == []
            w.calm()


def test_a_collection_that_was_spoiled_or_never_begun_does_not_count():
    pace = Pace()
    pace.begin("a", (0,), now=0.0)
    pace.spoil("a")
    pace.end("a", now=5.0)
    pace.end("b", now=5.0)
    assert pace.seconds_per_slot == {}


def test_a_spare_is_forgiven_its_pace_in_the_end():
    pace = Pace()
    for _ in range(2):
        pace.begin("a", (0,), now=0.0)
        pace.end("a", now=9.0)
    for _ in range(200):
        pace.stand_by("a")
    assert pace.seconds_per_slot == {"a": 9.0}
    pace.stand_by("a")
    assert pace.seconds_per_slot == {}
