"""A worker keeps to its core while it has that to itself, and only then."""

import os
import threading
import time
from itertools import pairwise

import pytest

from dppo.machine import usable_cores
from workers import core as module
from workers.core import Core

ALL = {2, 5, 7}


class Time:
    """A clock, and a thread that gets a share of it."""

    def __init__(self):
        self.now, self.computed, self.share = 100.0, 0.0, 1.0

    def core(self, number):
        return Core(number, lambda: self.now, lambda: self.computed)

    def work(self, core, seconds):
        with core:
            self.now += seconds
            self.computed += self.share * seconds


@pytest.fixture
def moves(monkeypatch):
    """Where the thread was put, in order; at first it may use cores 2, 5 and 7."""
    found: list[set[int]] = []
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: found[-1] if found else ALL)
    monkeypatch.setattr(os, "sched_setaffinity", lambda _, cores: found.append(cores))
    return found


def test_it_takes_its_core_after_half_a_second_of_work_and_stays(moves):
    time_ = Time()
    core = time_.core(1)
    for _ in range(4):
        time_.work(core, 0.12)
    assert moves == []
    for _ in range(100):
        time_.work(core, 0.12)
    assert moves == [{5}]


@pytest.mark.parametrize(("share", "leaves"), [(0.7, True), (0.8, False)])
def test_it_leaves_a_core_of_which_it_gets_less_than_three_quarters(moves, share, leaves):
    time_ = Time()
    core = time_.core(2)
    time_.work(core, 0.5)
    time_.share = share
    time_.work(core, 0.48)
    assert moves == [{7}]  # too short to tell
    time_.work(core, 0.02)
    assert moves[1:] == [ALL] * leaves


def test_it_comes_back_when_somebody_else_is_gone(moves):
    time_ = Time()
    core = time_.core(0)
    time_.work(core, 0.5)
    time_.share = 0.5
    time_.work(core, 0.5)
    assert moves == [{2}, ALL]
    time_.share = 1.0
    time_.work(core, 4.0)
    assert len(moves) == 2  # it waits five seconds at least
    time_.work(core, 7.0)
    assert moves[2:] == [{2}]


def waits_beside_another(time_, core, moves, count):
    """So many times between tries, while somebody is on the core."""
    tries: list[float] = []
    while len(tries) <= count:
        before = len(moves)
        time_.share = 0.5 if moves[-1:] == [{2}] else 0.9
        time_.work(core, 0.5)
        if len(moves) > before and moves[-1] == {2}:
            tries.append(time_.now)
    return [later - earlier for earlier, later in pairwise(tries)]


def test_it_tries_less_and_less_often_while_somebody_is_there_and_forgets_that_when_alone(moves):
    time_ = Time()
    core = time_.core(0)
    waits = waits_beside_another(time_, core, moves, 12)
    assert waits[0] < 12
    assert all(299 < wait < 605 for wait in waits[8:])
    time_.share = 1.0
    time_.work(core, 0.5)
    assert waits_beside_another(time_, core, moves, 2)[0] < 22


class Question:
    """Comes after so many looks; each takes 0.1 ms, and so does giving the core away."""

    def __init__(self, time_, monkeypatch, after):
        self._time, self._left, self.yields = time_, after, 0
        monkeypatch.setattr(os, "sched_yield", self._yield, raising=False)

    def _yield(self):
        self.yields += 1
        self._time.now += 0.0001

    def look(self):
        self._time.now += 0.0001
        self._left -= 1
        return "question" if self._left < 0 else None


@pytest.mark.parametrize("after", [0, 5])
def test_on_its_own_core_it_stays_awake_for_what_comes_soon(moves, monkeypatch, after):
    time_ = Time()
    core, question = time_.core(0), Question(time_, monkeypatch, after)
    time_.work(core, 0.5)
    assert moves == [{2}]
    assert core.awake(question.look) == "question"
    assert question.yields == after  # the learner's turn after every look


def test_what_does_not_come_soon_is_slept_for(moves, monkeypatch):
    time_ = Time()
    core, question = time_.core(0), Question(time_, monkeypatch, after=1000)
    time_.work(core, 0.5)
    begun = time_.now
    assert core.awake(question.look) is None
    assert 0.002 <= time_.now - begun < 0.0022
    assert moves == [{2}]


def test_where_somebody_else_may_be_it_sleeps_at_once(moves, monkeypatch):
    time_ = Time()
    core, question = time_.core(0), Question(time_, monkeypatch, after=0)
    assert core.awake(question.look) is None
    time_.work(core, 0.5)
    time_.share = 0.5
    time_.work(core, 0.5)
    assert moves == [{2}, ALL]
    assert core.awake(question.look) is None
    assert question.yields == 0


def test_work_is_counted_and_waiting_is_not(moves):
    time_ = Time()
    core = time_.core(0)
    for _ in range(20):
        time_.work(core, 0.1)
        time_.now += 5.0  # for the learner
    assert moves == [{2}]


def test_whom_somebody_else_has_moved_is_left_alone_and_sleeps(moves, monkeypatch):
    time_ = Time()
    core, question = time_.core(0), Question(time_, monkeypatch, after=0)
    time_.work(core, 0.5)
    moves.append({5})  # taskset
    time_.share = 0.5
    for _ in range(100):
        time_.work(core, 1.0)
    assert moves == [{2}, {5}]
    assert core.awake(question.look) is None


def test_it_lets_go_for_what_is_started_and_takes_its_core_after_half_a_second_again(moves):
    time_ = Time()
    core = time_.core(0)
    core.release()
    time_.work(core, 0.5)
    core.release()
    assert moves == [{2}, ALL]
    time_.work(core, 0.48)
    assert len(moves) == 2
    time_.work(core, 0.02)
    assert moves[2:] == [{2}]


def test_what_it_worked_before_it_let_go_does_not_count(moves):
    time_ = Time()
    core = time_.core(0)
    with core:
        time_.now += 10.0  # builds environments
        core.release()
        time_.now += 0.4
        time_.computed += 0.4
    assert moves == []


@pytest.mark.parametrize("number", [-1, 3])
def test_without_a_core_of_its_own_it_goes_anywhere(moves, number):
    time_ = Time()
    core = time_.core(number)
    time_.work(core, 10.0)
    time_.share = 0.1
    time_.work(core, 10.0)
    assert moves == []


def test_cores_that_are_taken_away_meanwhile_do_not_matter(moves, monkeypatch):
    def refuse(_pid, _cores):
        raise OSError(22, "Invalid argument")

    monkeypatch.setattr(os, "sched_setaffinity", refuse)
    time_ = Time()
    core = time_.core(0)
    question = Question(time_, monkeypatch, after=0)
    time_.work(core, 1.0)
    time_.work(core, 1.0)
    assert moves == []
    assert core.awake(question.look) is None  # it has none


def test_without_affinities_nothing_is_kept(monkeypatch):
    monkeypatch.delattr(os, "sched_getaffinity", raising=False)
    monkeypatch.delattr(os, "sched_setaffinity", raising=False)
    time_ = Time()
    time_.work(time_.core(0), 1.0)


@pytest.mark.skipif(usable_cores() < 2, reason="needs two cores")
def test_it_counts_what_its_own_thread_computes(monkeypatch):
    """Another thread is busy while this one sleeps: it does not have the core to itself."""
    before, stop = os.sched_getaffinity(0), threading.Event()
    busy = threading.Thread(target=lambda: [None for _ in iter(stop.is_set, True)])
    core = Core(0)
    try:
        monkeypatch.setattr(module, "_LOOK_SECONDS", 0.0)
        with core:
            sum(range(200_000))
        assert os.sched_getaffinity(0) == {min(before)}
        busy.start()
        with core:
            time.sleep(0.1)
        assert os.sched_getaffinity(0) == before
    finally:
        stop.set()
        os.sched_setaffinity(0, before)
        if busy.is_alive():
            busy.join()
