"""Updates that go on without late slots, from the learner's side. Time passes in silences."""

from dataclasses import replace

import pytest

from tests.story import ONES, UPDATE, NobodySpeaksError, Story


def nothing():
    """The event of a silence in which nobody speaks."""


class SlowStory(Story):
    """A story whose silences last ten seconds each; in each of them one event may happen."""

    def __init__(self):
        self.events, self.over = [], False
        super().__init__("w1", "w2", patience=100.0)
        one, two = self.players
        one.collected(0, 1)
        two.collected(2, 3)
        self.collect()
        for player in self.players:
            player.heard()
        self.over = True

    def look_after(self):
        """A question begins, or a silence ends."""
        self.now += 10
        if self.events:
            self.events.pop(0)()
        elif self.over:
            raise NobodySpeaksError

    def update(self, number, silences, *events):
        """Update `number`, which needs two slots; at the end of each silence one event."""
        self.events = [nothing, *events, *[nothing] * (silences - len(events))]
        return self.exchange.gather(replace(UPDATE, round=number), 2)


def both_quick(story, *numbers):
    """Updates in which everybody has answered as soon as the learner looks."""
    for number in numbers:
        for player, first in zip(story.players, (0, 2), strict=True):
            player.gradient(first, 2, round=number)
        assert story.update(number, 0).missing == ()
    for player in story.players:
        player.heard()


def test_a_gradient_within_the_deadline_is_taken_though_the_quorum_is_in():
    story = SlowStory()
    one, two = story.players
    one.gradient(0, 2)
    closed = story.update(1, 2, nothing, lambda: two.gradient(2, 2))
    assert sorted(closed.answers) == [(0, 2), (2, 2)]
    assert closed.waited == 20


def test_before_anything_is_known_the_deadline_is_half_a_minute():
    story = SlowStory()
    story.players[0].gradient(0, 2)
    closed = story.update(1, 4)
    assert closed.missing == (2, 3)
    assert closed.waited == 40  # three silences, and one more in which nothing else was there


def test_the_deadline_adapts_to_what_slots_took_lately():
    story = SlowStory()
    both_quick(story, 1, 2)
    story.players[0].gradient(0, 2, round=3)
    assert story.update(3, 2).missing == (2, 3)  # ten seconds are far beyond what they took


def test_without_the_quorum_no_deadline_closes_a_round():
    story = SlowStory()
    both_quick(story, 1, 2)
    with pytest.raises(NobodySpeaksError):
        story.update(3, 4)


def test_the_late_worker_is_asked_again_once_it_has_answered():
    story = SlowStory()
    one, two = story.players
    both_quick(story, 1, 2)
    one.gradient(0, 2, round=3)
    assert story.update(3, 2).missing == (2, 3)
    assert (one.heard(), two.heard()) == (["Update (0, 1)"], ["Update (2, 3)"])
    one.gradient(0, 2, round=4)
    assert story.update(4, 2).missing == (2, 3)
    assert (one.heard(), two.heard()) == (["Update (0, 1)"], [])
    two.gradient(2, 2, round=3, vector=9 * ONES)  # late: frees w2, counts for nothing
    one.gradient(0, 2, round=5)
    two.gradient(2, 2, round=5)
    closed = story.update(5, 0)
    assert [answer.vector.max() for answer in closed.answers.values()] == [1, 1]
    assert two.heard() == ["Update (2, 3)"]
    late = story.deadlines.take_late()
    assert [(each.id.round, each.slot) for each in late] == [(3, 2), (3, 3)]


def test_a_slot_that_was_dropped_as_often_as_it_may_be_is_waited_for():
    story = SlowStory()  # three times
    one, two = story.players
    both_quick(story, 1, 2)
    for number in (3, 4, 5):
        one.gradient(0, 2, round=number)
        assert story.update(number, 2).missing == (2, 3)
    one.gradient(0, 2, round=6)
    answers = (
        nothing,
        nothing,
        lambda: two.gradient(2, 2, round=3),  # late; now it is asked again
        lambda: two.gradient(2, 2, round=6),
    )
    closed = story.update(6, 4, *answers)
    assert (closed.missing, closed.required) == ((), {2, 3})
    one.gradient(0, 2, round=7)
    assert story.update(7, 2).missing == (2, 3)


def test_a_block_of_more_slots_than_there_are_is_ignored_in_no_time():
    story = SlowStory()
    one, two = story.players
    one.gradient(0, 1 << 62)
    one.gradient(1 << 62, 1 << 62)
    one.gradient(0, 2)
    two.gradient(2, 2)
    assert sorted(story.update(1, 0).answers) == [(0, 2), (2, 2)]
