"""Who may go on with a run, and who counts as one worker, as the learner's exchange sees it."""

import pytest

from dppo.errors import SupersededError
from tests.story import (
    HELLO,
    READY,
    UPDATE,
    Player,
    Story,
    two_that_have_collected,
)


def test_a_worker_of_a_later_learner_of_the_run_ends_this_one_at_once():
    story, one, _ = two_that_have_collected()
    one.gradient(0, 2)
    Player("w3", story.hub).say(HELLO, served_run="3f9c", served_generation=8)
    with pytest.raises(SupersededError) as refusal:
        story.ask(UPDATE)
    assert refusal.value.newest == 8
    assert str(refusal.value) == (
        "worker w3 on lab1 has served generation 8 of run 3f9c, this learner is generation 7: "
        "either another learner has gone on with the run, or this folder is an old copy of the "
        "run's; continue in the folder of the newest generation"
    )


@pytest.mark.parametrize(("run", "generation"), [("", 0), ("3f9c", 6), ("3f9c", 7), ("77aa", 99)])
def test_workers_of_earlier_learners_and_of_other_runs_are_welcome(run, generation):
    story = Story()
    player = Player("w1", story.hub)
    player.say(HELLO, served_run=run, served_generation=generation)
    player.say(READY)
    story.exchange.wait_for_environment()
    assert player.heard() == ["Welcome"]


def test_a_name_that_says_hello_twice_is_one_worker_that_has_lost_its_slots():
    story, one, two = two_that_have_collected()
    one.say(HELLO)  # its slots go to w2, which catches up
    one.say(READY)
    two.gradient(2, 2)
    two.collected(0, 1)
    two.gradient(0, 2)
    assert sorted(story.ask(UPDATE).answers) == [(0, 2), (2, 2)]
    assert story.exchange.num_workers == 2
    assert one.heard() == ["Update (0, 1)", "Welcome"]
