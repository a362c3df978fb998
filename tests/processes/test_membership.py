"""A worker's life: it knocks until it is let in, outlives learners, goes when told to."""

import json
import logging
import re
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from dppo.backoff import Backoff
from dppo.config import Config, RunConfig
from dppo.wire.memory_links import MemoryHub
from dppo.wire.messages import Failure, Hello, Ready, Restore, Stop, Update, Welcome
from workers import membership
from workers.core import Core
from workers.membership import LearnerAbsentError, Member, wait_for

PATIENCE = 20.0
"""Longest wait for a learner [s]; only a broken member takes it."""
PAUSE, END = Stop(reason="the learner pauses", final=False), Stop(reason="finished", final=True)


def welcome(generation=1, env="InvertedPendulum-v5", run="3f9c"):
    config = json.dumps(Config(run=RunConfig(env=env)).to_dict())
    return Welcome(run=run, generation=generation, config=config, name="main")


def update(generation):
    """A task for slots whose experience the worker does not have."""
    return Update(
        generation=generation, iteration=1, round=1, slots=(0,), stopped=(),
        parameters=np.zeros(3, np.float32), advantages=np.zeros(7),
    )  # fmt: skip


class Meeting:
    """A member, and the test in the learner's place."""

    def __init__(self, patience=PATIENCE, core=None):
        hub = MemoryHub()
        self.learner = hub.learner()
        self.member = Member("w1", hub.worker("w1"), patience, core)

    def says(self, *messages):
        """Put what the learner says into the member's queue."""
        for message in messages:
            self.learner.send("w1", message)

    def goes_away(self):
        self.learner.close()

    def heard(self):
        """What the member has said so far."""
        said = []
        while (message := self.learner.receive(0.0)) is not None:
            said.append(message)
        return said

    def kinds(self):
        return [type(message) for message in self.heard()]


def test_a_member_says_hello_then_ready_with_the_sizes_of_its_environment():
    meeting = Meeting()
    meeting.says(welcome(generation=3), END)
    assert meeting.member.live() == END
    hello, ready = meeting.heard()
    assert isinstance(hello, Hello)
    assert isinstance(ready, Ready)
    assert (hello.worker, ready.worker, ready.generation) == ("w1", "w1", 3)
    assert (ready.obs_size, ready.action_kind, ready.action_sizes) == (4, "box", (1,))


def test_a_member_says_hello_again_until_it_is_welcomed():
    meeting = Meeting()
    with ThreadPoolExecutor(1) as pool:
        life = pool.submit(meeting.member.live)
        hellos = [meeting.learner.receive(PATIENCE) for _ in range(3)]
        meeting.says(welcome(), END)
        assert life.result(PATIENCE) == END
    assert isinstance(hellos[0], Hello)
    assert hellos == [hellos[0]] * 3


def test_a_member_joins_the_next_learner_when_one_is_lost():
    meeting = Meeting()
    meeting.says(welcome(generation=1))
    meeting.goes_away()
    meeting.says(welcome(generation=2), END)
    assert meeting.member.live() == END
    heard = meeting.heard()
    assert [type(message) for message in heard] == [Hello, Ready] * 2
    assert [message.generation for message in heard if isinstance(message, Ready)] == [1, 2]


def test_a_member_stays_when_the_learner_only_pauses():
    meeting = Meeting()
    meeting.says(welcome(generation=1), PAUSE, welcome(generation=2), END)
    assert meeting.member.live() == END
    assert meeting.kinds() == [Hello, Ready] * 2


def test_a_member_that_is_asked_for_what_it_does_not_have_joins_anew():
    meeting = Meeting()
    meeting.says(welcome(), update(generation=1), welcome(), END)
    assert meeting.member.live() == END
    assert meeting.kinds() == [Hello, Ready] * 2


class CountingCore(Core):
    """How often work began and was done, and the core was let go of."""

    begun = done = released = 0

    def release(self):
        self.released += 1

    def __enter__(self):
        self.begun += 1

    def __exit__(self, *_error):
        self.done += 1


def test_tasks_are_done_on_the_workers_core_and_nothing_else_is():
    core = CountingCore()
    meeting = Meeting(core=core)
    restore = Restore(generation=2, iteration=0, slot=0, snapshot=b"")
    meeting.says(welcome(1), update(1), welcome(2), restore, restore, update(1), END)
    assert meeting.member.live() == END
    assert (core.begun, core.done) == (3, 3)  # the last is a task of an older learner
    assert core.released == 2  # an environment is made for every learner


class SleeplessCore(Core):
    """Awake for whatever is there already."""

    found = 0

    def awake(self, look):
        message = look()
        self.found += message is not None
        return message


def test_what_comes_while_it_is_awake_is_done():
    core = SleeplessCore()
    meeting = Meeting(core=core)
    restore = Restore(generation=1, iteration=0, slot=0, snapshot=b"")
    meeting.says(welcome(1), restore, restore, END)
    assert meeting.member.live() == END
    assert core.found == 3  # the end as well


def test_a_task_of_an_older_learner_is_ignored():
    meeting = Meeting()
    meeting.says(welcome(generation=2), update(generation=1), END)
    assert meeting.member.live() == END
    assert meeting.kinds() == [Hello, Ready]


def test_hello_says_which_learner_was_served_last():
    meeting = Meeting()
    meeting.says(welcome(generation=3), PAUSE, welcome(generation=4, run="77aa"), PAUSE, END)
    assert meeting.member.live() == END
    hellos = [message for message in meeting.heard() if isinstance(message, Hello)]
    served = [(hello.served_run, hello.served_generation) for hello in hellos]
    assert served == [("", 0), ("3f9c", 3), ("77aa", 4)]


def test_a_learner_of_the_past_is_ignored_and_told_so(caplog):
    """Generation 3 of the run after generation 5: not joined, and the next Hello names 5."""
    meeting = Meeting()
    meeting.says(welcome(generation=5), PAUSE, welcome(run="77aa"), PAUSE, welcome(generation=3))
    with ThreadPoolExecutor(1) as pool:
        life = pool.submit(meeting.member.live)
        heard = [meeting.learner.receive(PATIENCE) for _ in range(6)]
        meeting.says(END)
        assert life.result(PATIENCE) == END
    assert [type(message) for message in heard] == [Hello, Ready, Hello, Ready, Hello, Hello]
    assert [message.generation for message in heard if isinstance(message, Ready)] == [5, 1]
    last = heard[-1]
    assert isinstance(last, Hello)
    assert (last.served_run, last.served_generation) == ("3f9c", 5)
    assert "ignored the learner of run main, generation 3: generation 5 has gone on" in caplog.text


def test_the_same_generation_is_joined_again_and_a_later_one_too():
    meeting = Meeting()
    meeting.says(welcome(generation=5), PAUSE, welcome(generation=5), PAUSE, welcome(6), END)
    assert meeting.member.live() == END
    assert meeting.kinds() == [Hello, Ready] * 3


def test_another_run_may_have_a_lower_generation():
    meeting = Meeting()
    meeting.says(welcome(generation=5), PAUSE, welcome(generation=1, run="77aa"), END)
    assert meeting.member.live() == END
    assert meeting.kinds() == [Hello, Ready] * 2


@pytest.mark.parametrize(
    ("settings", "reason"),
    [
        (welcome(env="NoSuch-v1"), "NoSuch-v1"),
        (Welcome(run="3f9c", generation=1, config='{"later": {}}'), "the same dppo version"),
    ],
)
def test_a_member_that_cannot_build_what_is_asked_says_why_and_lets_the_learner_decide(
    settings, reason
):
    meeting = Meeting()
    meeting.says(settings, END)
    assert meeting.member.live() == END
    hello, failure = meeting.heard()
    assert isinstance(hello, Hello)
    assert isinstance(failure, Failure)
    assert failure.usage
    assert reason in failure.reason


def test_a_member_gives_up_after_its_patience():
    meeting = Meeting(patience=0.15)
    with pytest.raises(LearnerAbsentError, match=r"did not answer worker w1 for 0\.15 s; look"):
        meeting.member.live()
    assert set(meeting.kinds()) == {Hello}


def test_a_member_says_again_and_again_that_it_waits_for_a_welcome(caplog, monkeypatch):
    monkeypatch.setattr(membership, "_REMARK_SECONDS", 0.05)
    caplog.set_level(logging.INFO)
    with pytest.raises(LearnerAbsentError):
        Meeting(patience=0.25).member.live()
    assert caplog.text.count("waiting for a learner's Welcome, for 0 s") >= 2


def test_whoever_waits_for_a_learner_says_where(caplog):
    caplog.set_level(logging.INFO)
    with pytest.raises(LearnerAbsentError):
        wait_for(lambda: None, "tcp/lab1:7447", patience=0.05)
    assert "waiting for a learner at tcp/lab1:7447 (0 s so far)" in caplog.text


def test_waiting_for_a_learner_gives_up_with_a_sentence():
    sentence = "no learner answered at tcp/lab1:7447 for 0.05 s; is it running"
    with pytest.raises(LearnerAbsentError, match=re.escape(sentence)):
        wait_for(lambda: None, "tcp/lab1:7447", patience=0.05)


def test_waiting_for_a_learner_ends_when_it_is_there():
    link = MemoryHub().worker("w1")
    tries = iter([None, None, link])
    assert wait_for(lambda: next(tries), "tcp/lab1:7447", patience=PATIENCE) is link


def test_waits_between_two_tries_grow_and_stay_within_bounds():
    backoff = Backoff(first=0.1, longest=2.0)
    full = [0.1, 0.2, 0.4, 0.8, 1.6] + [2.0] * 15  # doubled up to 2 s
    for _ in range(2):
        waits = [backoff.next() for _ in full]
        for wait, most in zip(waits, full, strict=True):
            assert most / 2 <= wait <= most
        backoff.again()


def test_two_that_wait_do_not_knock_in_step():
    one, two = Backoff(0.1, 2.0), Backoff(0.1, 2.0)
    assert [one.next() for _ in range(5)] != [two.next() for _ in range(5)]
