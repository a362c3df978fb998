"""A worker keeps to its core while it has that to itself, and only then."""

import os
from itertools import pairwise

import pytest

from workers.core import Core


class Time:
    """A clock, and a thread that gets a share of it."""

    def __init__(self):
        self.now, self.computed, self.share = 0.0, 0.0, 1.0

    def work(self, core, seconds):
        with core:
            self.now += seconds
            self.computed += self.share * seconds


@pytest.fixture
def moves(monkeypatch):
    """Where the thread was put, in order; it may use cores 2, 5 and 7."""
    found = []
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: {7, 2, 5} if pid == 0 else None)
    monkeypatch.setattr(os, "sched_setaffinity", lambda pid, cores: found.append((pid, cores)))
    return found


def test_it_takes_its_core_at_once_and_stays(moves):
    time = Time()
    core = Core(1, lambda: time.now, lambda: time.computed)
    for _ in range(100):
        time.work(core, 0.2)
    assert moves == [(0, {5})]


def test_it_leaves_a_core_that_somebody_else_wants_and_comes_back_when_that_is_over(moves):
    time = Time()
    core = Core(2, lambda: time.now, lambda: time.computed)
    time.share = 0.5
    time.work(core, 0.4)
    assert moves == [(0, {7})]  # too short to tell
    time.work(core, 0.2)
    assert moves[1:] == [(0, {2, 5, 7})]
    time.share = 1.0
    time.work(core, 4.0)
    assert len(moves) == 2  # it waits five seconds at least
    time.work(core, 7.0)
    assert moves[2:] == [(0, {7})]


def test_it_tries_less_and_less_often_while_somebody_is_there(moves):
    time = Time()
    core = Core(0, lambda: time.now, lambda: time.computed)
    tries = []
    for _ in range(10_000):
        before = len(moves)
        time.share = 0.5 if moves[-1] == (0, {2}) else 0.9
        time.work(core, 0.5)
        if len(moves) > before and moves[-1] == (0, {2}):
            tries.append(time.now)
    waits = [later - earlier for earlier, later in pairwise(tries)]
    assert 4 < tries[0] < 11
    assert all(200 < wait < 605 for wait in waits[8:])
    assert waits[0] < 25


def test_work_is_counted_and_waiting_is_not(moves):
    time = Time()
    core = Core(0, lambda: time.now, lambda: time.computed)
    for _ in range(10):
        time.work(core, 0.1)
        time.now += 5.0  # for the learner
    assert moves == [(0, {2})]


@pytest.mark.parametrize("number", [-1, 3])
def test_without_a_core_of_its_own_it_goes_anywhere(moves, number):
    time = Time()
    core = Core(number, lambda: time.now, lambda: time.computed)
    time.share = 0.1
    time.work(core, 10.0)
    assert moves == []


def test_cores_that_are_taken_away_meanwhile_do_not_matter(moves, monkeypatch):
    def refuse(_pid, _cores):
        raise OSError(22, "Invalid argument")

    monkeypatch.setattr(os, "sched_setaffinity", refuse)
    with Core(0):
        pass


def test_without_affinities_nothing_is_kept(monkeypatch):
    monkeypatch.delattr(os, "sched_getaffinity", raising=False)
    monkeypatch.delattr(os, "sched_setaffinity", raising=False)
    with Core(0):
        pass
