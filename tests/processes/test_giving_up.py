"""Who stalls is given up, who is only slow is not; what cannot be believed is computed again."""

from dataclasses import replace

import numpy as np
import pytest

from dppo.errors import RunFailedError
from tests.story import (
    ALIVE,
    ALL,
    CATCHING_UP,
    COLLECT,
    FAILURE,
    ONES,
    UPDATE,
    NobodySpeaksError,
    Player,
    Story,
    two_that_have_collected,
)

NAN = np.array([1, np.nan, 1], np.float32)
HUGE = np.full(3, 1e30, np.float32)


def ready_to_be_asked(story, player):
    """A worker that has catched up by itself: what it says when it is asked for slots 0 and 1."""
    player.collected(0, 1)
    player.gradient(0, 2)


def test_a_worker_without_a_sign_of_life_is_given_up_and_its_heir_catches_up():
    story, one, two = two_that_have_collected()
    two.gradient(2, 2)
    # one second is allowed: it is over in the fifth quarter
    story.silent(6, after_5=lambda: ready_to_be_asked(story, two))
    assert story.ask(UPDATE).missing == ()
    assert two.heard() == ["Update (2, 3)", *CATCHING_UP]
    assert one.heard() == ["Update (0, 1)", "Stop"]
    assert not one.last.final
    assert one.last.reason == "it was given up, silent for 1.2 s"


def test_a_worker_that_gets_on_is_waited_for_however_slow_it_is():
    story, one, two = two_that_have_collected()
    two.gradient(2, 2)

    def still_at_it(step):
        one.say(ALIVE, done=step)

    beats = {f"after_{k}": lambda k=k: still_at_it(k) for k in range(2, 40, 3)}
    story.silent(41, after_40=lambda: one.gradient(0, 2), **beats)
    assert {answer.worker for answer in story.ask(UPDATE).answers.values()} == {"w1", "w2"}


def test_a_worker_that_lives_but_hangs_is_given_up():
    story, one, two = two_that_have_collected()
    two.gradient(2, 2)
    beats = {f"after_{k}": lambda: one.say(ALIVE, done=17) for k in range(1, 42)}
    story.silent(43, after_42=lambda: ready_to_be_asked(story, two), **beats)
    assert story.ask(UPDATE).missing == ()
    assert one.heard() == ["Update (0, 1)", "Stop"]
    assert one.last.reason == "it was given up, alive but without progress for 10.2 s"


def test_a_learner_that_was_stopped_itself_gives_nobody_up():
    story, one, two = two_that_have_collected()
    two.gradient(2, 2)
    story.silent(2, after_1=lambda: setattr(story, "now", story.now + 3600.0))
    with pytest.raises(NobodySpeaksError):
        story.ask(UPDATE)
    assert one.heard() == ["Update (0, 1)"]


def test_a_worker_that_owes_nothing_may_be_silent():
    story, one, two = two_that_have_collected()
    one.gradient(0, 2)
    story.silent(9, **{f"after_{k}": lambda k=k: two.say(ALIVE, done=k) for k in range(1, 9)})
    with pytest.raises(NobodySpeaksError):
        story.ask(UPDATE)
    assert one.heard() == ["Update (0, 1)"]


def test_a_worker_that_was_given_up_is_told_to_join_anew_when_it_wakes_up():
    story, one, two = two_that_have_collected()
    two.gradient(2, 2)
    story.silent(6, after_5=lambda: ready_to_be_asked(story, two))
    story.ask(UPDATE)
    one.heard()
    one.gradient(0, 2, vector=9 * ONES)  # late, and of nobody
    one.say(ALIVE, done=5)
    one.join()
    two.gradient(0, 4, round=2)
    story.pauses = 0
    assert story.ask(replace(UPDATE, round=2)).answers[0, 4].worker == "w2"
    assert one.heard() == ["Stop", "Welcome"]
    assert story.exchange.num_workers == 2


def test_a_gradient_that_is_not_finite_is_refused_and_computed_elsewhere():
    story, one, two = two_that_have_collected()
    one.gradient(0, 2, vector=NAN)
    two.gradient(2, 2)
    ready_to_be_asked(story, two)
    closed = story.ask(UPDATE)
    assert sorted(closed.answers) == [(0, 2), (2, 2)]
    assert all(np.isfinite(answer.vector).all() for answer in closed.answers.values())
    assert one.heard() == ["Update (0, 1)", "Stop"]
    assert not one.last.final


def test_a_gradient_that_is_not_finite_on_two_workers_ends_the_run_and_names_both():
    story, one, two = two_that_have_collected()
    one.gradient(0, 2, vector=NAN)
    two.gradient(2, 2)
    two.collected(0, 1)
    two.gradient(0, 2, vector=NAN)
    with pytest.raises(RunFailedError, match=r"0-1 on worker w2 \(lab1.*second time after .* w1"):
        story.ask(UPDATE)


@pytest.mark.parametrize("field", ["obs", "returns", "advantages", "fit", "start_sigma"])
def test_statistics_that_are_not_finite_are_refused(field):
    story = Story("w1", "w2")
    one, two = story.players
    good = getattr(_collected(), field)
    one.collected(0, **{field: np.full_like(good, np.inf)})
    one.collected(1)  # of a worker that has been sent to join anew
    two.collected(2, 3, 0, 1)
    assert {answer.worker for answer in story.collect().answers.values()} == {"w2"}


def _collected():
    from tests.story import COLLECTED

    return COLLECTED


def after_many_updates():
    """Twelve updates have said what is usual: norms of 1.7 over 64 samples."""
    story, one, two = two_that_have_collected()
    weights = np.array([64.0, 64.0, 64.0, 0, 0, 0, 0])
    for update in range(1, 13):
        one.gradient(0, 2, round=update, sums=weights)
        two.gradient(2, 2, round=update, sums=weights)
        story.ask(replace(UPDATE, round=update))
    one.heard(), two.heard()
    return story, one, two


def test_a_wild_gradient_is_refused_until_another_worker_finds_the_same():
    story, one, two = after_many_updates()
    one.gradient(0, 2, round=13, vector=HUGE)
    two.gradient(2, 2, round=13)
    two.collected(0, 1)
    two.gradient(0, 2, round=13)
    closed = story.ask(replace(UPDATE, round=13))
    assert max(answer.vector.max() for answer in closed.answers.values()) == 1.0
    assert one.heard() == ["Update (0, 1)", "Stop"]


def test_a_gradient_that_is_wild_on_two_workers_is_no_fault_of_theirs_and_counts():
    story, one, two = after_many_updates()
    one.gradient(0, 2, round=13, vector=HUGE)
    two.gradient(2, 2, round=13)
    two.collected(0, 1)
    two.gradient(0, 2, round=13, vector=HUGE)
    closed = story.ask(replace(UPDATE, round=13))
    assert closed.answers[0, 2].vector.max() == HUGE.max()


def test_a_worker_that_is_refused_three_times_is_benched():
    story, liar, honest = two_that_have_collected()
    lied, kept = (0, 2), (2, 2)
    for iteration in (1, 3, 5):
        liar.gradient(*lied, iteration=iteration, vector=NAN)
        honest.gradient(*kept, iteration=iteration)
        honest.collected(lied[0], lied[0] + 1, iteration=iteration)
        honest.gradient(*lied, iteration=iteration)
        story.ask(replace(UPDATE, iteration=iteration))
        assert liar.heard()[-1] == "Stop"
        if iteration < 5:
            assert not liar.last.final
            liar.join()
            honest.collected(*ALL, iteration=iteration + 1)
            story.collect(replace(COLLECT, iteration=iteration + 1))
            honest.collected(0, 1, iteration=iteration + 2)
            liar.collected(2, 3, iteration=iteration + 2)
            story.collect(replace(COLLECT, iteration=iteration + 2))
            lied, kept = (2, 2), (0, 2)  # it comes after the honest one now
    liar.join()
    honest.gradient(0, 4, iteration=5, round=2)
    story.ask(replace(UPDATE, iteration=5, round=2))
    assert liar.heard() == ["Stop"]
    assert liar.last.final
    assert liar.last.sent_away
    assert "again and again" in liar.last.reason


def test_an_environment_that_fails_once_is_tried_elsewhere():
    story, one, two = two_that_have_collected()
    one.say(FAILURE, slot=0, reason="slot 0: the arm fell off")
    two.gradient(2, 2)
    ready_to_be_asked(story, two)
    assert story.ask(UPDATE).missing == ()
    assert one.heard() == ["Update (0, 1)", "Stop"]


def test_an_environment_that_fails_twice_ends_the_run_and_names_both_workers():
    story, one, two = two_that_have_collected()
    one.say(FAILURE, generation=6, slot=0, reason="of an older learner")
    one.say(FAILURE, slot=0, reason="slot 0: the arm fell off")
    two.say(FAILURE, slot=0, reason="slot 0: the arm fell off")
    match = (
        r"slot 0: the arm fell off; worker w2 \(lab1, pid 12\); .* second time, after worker w1"
    )
    with pytest.raises(RunFailedError, match=match):
        story.ask(UPDATE)


def test_a_slot_that_loses_holder_after_holder_ends_the_run():
    story = Story("w1")
    story.players[0].collected(*ALL)
    story.collect()
    for number in range(1, 32):
        Player(f"w{number + 1}", story.hub).join()
        story.hub.lose(f"w{number}")
    with pytest.raises(RunFailedError, match="have lost more than 30 workers in a row"):
        story.ask(UPDATE)


def test_a_slot_that_stalls_on_worker_after_worker_ends_the_run():
    story = Story("w1")
    story.players[0].collected(*ALL)
    story.collect()
    names = iter("bcdefgh")

    def next_one():
        if story.exchange.num_workers == 0:
            Player(next(names), story.hub).join()

    silences = 4 * (1 + 2 + 4 + 8 + 16 + 32) + 20  # each one is waited for twice as long
    story.silent(silences, **{f"after_{k}": next_one for k in range(1, silences)})
    with pytest.raises(RunFailedError, match="stall on worker after worker, the last one was"):
        story.ask(UPDATE)


def test_a_wait_is_described_by_who_keeps_us_waiting():
    story, one, _ = two_that_have_collected()
    one.gradient(0, 2)
    story.silent(3)
    with pytest.raises(NobodySpeaksError):
        story.ask(UPDATE)
    words = story.exchange.waiting()
    assert words == (
        "iteration 1, update 1: have slots 0-1; waiting for worker w2 (lab1, pid 12) "
        "(slots 2-3), silent for 0.8 s"
    )
