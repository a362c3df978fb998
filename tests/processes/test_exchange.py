"""A round from the learner's side: whoever dies, is late, or talks nonsense."""

from dataclasses import replace

import numpy as np
import pytest

from dppo.errors import UsageError
from dppo.pace import Pace
from dppo.wire.messages import VERSION
from tests.story import (
    ALL,
    CATCHING_UP,
    COLLECT,
    FAILURE,
    HELLO,
    MEASURE,
    MEASURED,
    OBS,
    ONES,
    PARAMETERS,
    UPDATE,
    WELCOME,
    NobodySpeaksError,
    Player,
    Story,
    two_that_have_collected,
)


def test_a_worker_is_welcomed_then_asked_for_all_slots():
    story = Story()
    one = Player("w1", story.hub).join()
    assert story.exchange.wait_for_environment().obs_size == OBS
    assert one.heard() == ["Welcome"]
    assert one.last == WELCOME
    one.collected(*ALL)
    assert sorted(story.collect(COLLECT, {}).answers) == [(0, 1), (1, 1), (2, 1), (3, 1)]
    assert one.heard() == ["Collect (0, 1, 2, 3)"]


def test_what_is_left_for_meanwhile_is_done_once_the_question_is_put():
    story = Story("w1")
    heard = []
    story.players[0].heard()
    story.exchange.meanwhile.add(lambda: heard.extend(story.players[0].heard()))
    story.players[0].collected(*ALL)
    story.collect()
    assert heard == ["Collect (0, 1, 2, 3)"]


def test_a_workers_pace_counts_from_the_question_not_from_what_is_done_meanwhile(monkeypatch):
    begun = []
    monkeypatch.setattr(Pace, "begin", lambda _self, _worker, _slots, now: begun.append(now))
    story = Story("w1")
    asked = story.now
    story.exchange.meanwhile.add(lambda: setattr(story, "now", asked + 4.0))
    story.players[0].collected(*ALL)
    story.collect()
    assert begun[-1] == asked


def test_a_worker_that_is_not_ready_or_has_no_proper_name_gets_no_task():
    story = Story("w1")
    unready, unnamed = Player("w2", story.hub), Player("w/3", story.hub)
    unready.say(HELLO)
    unnamed.join()
    story.players[0].collected(*ALL)
    story.collect()
    assert (unready.heard(), unnamed.heard()) == (["Welcome"], [])
    assert story.exchange.num_workers == 1


def test_a_worker_of_another_protocol_version_is_told_so_and_sent_away():
    story = Story("w1")
    other = Player("w2", story.hub)
    other.say(HELLO, protocol=99)
    story.players[0].collected(*ALL)
    story.collect()
    assert other.heard() == ["Stop"]
    assert (other.last.final, other.last.sent_away) == (True, True)
    assert f"speaks protocol version 99, the learner speaks {VERSION}" in other.last.reason
    assert other.last.reason.endswith("install the same dppo on both")
    assert list(story.exchange.roster) == ["w1"]


def test_the_heir_of_a_lost_worker_catches_up_once_and_joins_at_the_present_question():
    story, _, two = two_that_have_collected()
    two.gradient(2, 2)
    story.hub.lose("w1")
    two.collected(0, 1, exact=False)
    two.gradient(0, 2)
    assert sorted(story.ask(UPDATE).answers) == [(0, 2), (2, 2)]
    assert not story.exchange.exact  # the move lost bits: the run says so
    assert two.heard() == ["Update (2, 3)", *CATCHING_UP]
    for slot in ALL:
        two.say(MEASURED, first=slot)
    assert story.ask(MEASURE).missing == ()
    assert two.heard() == ["Measure (0, 1, 2, 3)"]


def test_in_the_first_iteration_the_heir_starts_afresh():
    story = Story()
    one, two = Player("w1", story.hub).join(), Player("w2", story.hub).join()
    story.exchange.wait_for_environment()
    one.collected(0, iteration=0)
    story.hub.lose("w1")
    two.collected(1, 2, 3, iteration=0)
    assert story.collect(replace(COLLECT, iteration=0), {}).missing == ()
    assert two.heard() == ["Welcome", "Collect (1, 2, 3)"]  # slot 0 had answered


def test_an_heir_lost_while_it_catches_up_passes_the_slots_on():
    story = Story("w1", "w2", "w3")
    one, two, three = story.players
    one.collected(0, 1)
    two.collected(2)
    three.collected(3)
    story.collect()
    three.heard()
    three.gradient(3, 1)
    story.hub.lose("w1")  # slot 0 goes to w2, slot 1 to w3
    two.collected(0)
    three.collected(1)
    three.gradient(1, 1)
    story.hub.lose("w2")
    three.collected(0, 2)
    three.gradient(0, 1)
    three.gradient(2, 1)
    assert story.ask(UPDATE).missing == ()
    assert three.heard() == [
        "Update (3,)",
        *("Restore 1", "Collect (1,)", "Update (1,)"),
        *("Restore 0", "Restore 2", "Collect (0, 2)", "Update (0, 2)"),
    ]


def test_when_all_are_lost_the_next_one_to_join_gets_everything():
    story, _, _ = two_that_have_collected()
    story.hub.lose("w1")
    story.hub.lose("w2")
    new = Player("w3", story.hub).join()
    new.collected(*ALL)
    new.gradient(0, 4)
    assert list(story.ask(UPDATE).answers) == [(0, 4)]
    restores = [f"Restore {slot}" for slot in ALL]
    assert new.heard() == ["Welcome", *restores, "Collect (0, 1, 2, 3)", "Update (0, 1, 2, 3)"]


def test_answers_of_another_round_iteration_or_generation_and_of_strangers_are_ignored():
    story, one, two = two_that_have_collected()
    for facts in ({"round": 2}, {"iteration": 0}, {"generation": 6}):
        one.gradient(0, 2, vector=9 * ONES, **facts)
    Player("stranger", story.hub).gradient(0, 2, vector=9 * ONES)
    one.say(MEASURED, round=1)  # not what was asked
    one.gradient(0, 2)
    two.gradient(2, 2)
    closed = story.ask(UPDATE)
    assert [answer.vector.tolist() for answer in closed.answers.values()] == [[1, 1, 1]] * 2


def test_a_repeated_answer_counts_once():
    story, one, two = two_that_have_collected()
    one.gradient(0, 2)
    one.gradient(0, 2, vector=9 * ONES)
    two.gradient(0, 4)  # repeats 0 and 1: ignored whole
    two.gradient(2, 2)
    closed = story.ask(UPDATE)
    found = {block: answer.vector.max() for block, answer in closed.answers.items()}
    assert found == {(0, 2): 1, (2, 2): 1}


def test_an_answer_of_a_wrong_length_expels_its_sender_and_moves_its_slots():
    story, one, two = two_that_have_collected()
    one.gradient(0, 2, vector=np.ones(PARAMETERS + 1, np.float32))
    two.gradient(2, 2)
    two.collected(0, 1)
    two.gradient(0, 2)
    assert sorted(answer.worker for answer in story.ask(UPDATE).answers.values()) == ["w2", "w2"]
    assert one.heard() == ["Update (0, 1)", "Stop"]
    assert one.last.final
    assert "Gradient.vector of 4 numbers, expected 3" in one.last.reason


def test_in_a_silence_it_looks_after_the_world_which_may_end_the_wait():
    story, one, _ = two_that_have_collected()
    one.gradient(0, 2)
    with pytest.raises(NobodySpeaksError):
        story.ask(UPDATE)
    assert story.pauses == 2  # before the question, and in the silence after the answer


def headed(header):
    return len(header).to_bytes(8, "little") + header


ENDS = {"text": '"x"', "nothing": "null", "list": "[1]"}
DAMAGED = {
    name: headed(f'{{"a": {{"dtype": "F32", "data_offsets": [0, {end}]}}}}'.encode())
    for name, end in ENDS.items()
} | {"depth": headed(b"[" * 100_000)}
COLLECTIONS = {name: ({"snapshot": snapshot}, "is damaged") for name, snapshot in DAMAGED.items()}
COLLECTIONS |= {
    "squares": (
        {"obs": np.array([4.0, *[0.0] * OBS, *[9.0] * (OBS - 1), -1.0])},
        "with a sum of squares below 0",
    ),
    "many": ({"fit": np.array([1e9, *[0.0] * 6])}, "over 1e+09 samples"),
    "fewer than none": ({"start_sigma": np.array([-1.0, 0.0, 0.0])}, "over -1 samples"),
}


@pytest.mark.parametrize(("facts", "sentence"), COLLECTIONS.values(), ids=COLLECTIONS)
def test_what_cannot_be_a_collection_expels_its_sender(facts, sentence):
    story = Story("w1", "w2")
    one, two = story.players
    one.collected(0, 1, **facts)
    two.collected(2, 3)
    two.collected(0, 1)
    assert {answer.worker for answer in story.collect().answers.values()} == {"w2"}
    assert one.heard()[-1] == "Stop"
    assert one.last.final
    assert sentence in one.last.reason


@pytest.mark.parametrize(
    ("facts", "sentence"),
    [
        ({"kls": np.zeros(3)}, "Measured.kls of 3 numbers, expected 2"),
        ({"weights": np.ones(1)}, "Measured.weights of 1 numbers, expected 2"),
        ({"weights": np.array([1.0, 0.0])}, "a Measured over no samples"),
        ({"weights": np.array([1.0, 1e9])}, "over 1e+09 samples"),
    ],
)
def test_what_cannot_be_a_measurement_expels_its_sender(facts, sentence):
    story = Story("w1", "w2")
    one, two = story.players
    one.collected(0, 1)
    two.collected(2, 3)
    story.collect()
    one.say(MEASURED, **{"size": 2, "kls": np.zeros(2), "weights": np.ones(2), **facts})
    two.collected(0, 1)
    for first in (0, 2):
        two.say(MEASURED, first=first, size=2, kls=np.zeros(2), weights=np.ones(2))
    assert {answer.worker for answer in story.ask(MEASURE).answers.values()} == {"w2"}
    assert one.heard()[-1] == "Stop"
    assert one.last.final
    assert sentence in one.last.reason


@pytest.mark.parametrize(
    "facts",
    [
        {"obs_size": -5}, {"obs_size": 0}, {"action_sizes": ()}, {"action_sizes": (-1,)},
        {"action_sizes": (10**15,)}, {"action_kind": "foo"},
    ],
    ids=str,
)  # fmt: skip
def test_an_environment_that_cannot_be_is_not_taken_for_the_runs(facts):
    story = Story()
    odd, good = Player("w1", story.hub).join(**facts), Player("w2", story.hub).join()
    assert story.exchange.wait_for_environment().obs_size == OBS
    assert odd.heard() == ["Welcome", "Stop"]
    assert odd.last.final
    assert "sent a Ready with" in odd.last.reason
    assert good.heard() == ["Welcome"]


def test_settings_that_no_worker_can_build_are_the_users_error():
    story = Story()
    player = Player("w1", story.hub)
    player.say(HELLO)
    player.say(FAILURE, usage=True, reason="no such environment")
    with pytest.raises(UsageError, match="no such environment"):
        story.exchange.wait_for_environment()


def test_workers_that_differ_or_cannot_build_the_environment_later_on_are_sent_away():
    story = Story("w1")
    other, poor = Player("w2", story.hub).join(obs_size=OBS + 1), Player("w3", story.hub)
    poor.say(HELLO)
    poor.say(FAILURE, usage=True, reason="mujoco is missing")
    story.players[0].collected(*ALL)
    story.collect()
    for player, why in ((other, "another environment than w1"), (poor, "mujoco is missing")):
        assert player.heard() == ["Welcome", "Stop"]
        assert player.last.final
        assert player.last.sent_away
        assert why in player.last.reason
