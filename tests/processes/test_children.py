"""Child processes: what they answer, and that none outlives its parent."""

import os
import signal
import subprocess
import sys
import textwrap
from contextlib import contextmanager
from subprocess import PIPE

import numpy as np
import pytest

from dppo.children import answers, children
from tests.support import ROOT, descendants, is_alive, wait_until

PATH = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
SOON = 10.0
"""Longest wait for the end of a process [s]; far shorter than what it had left to do."""


@pytest.fixture(autouse=True)
def children_find_our_modules(monkeypatch):
    monkeypatch.setenv("PYTHONPATH", PATH)


def answered(*tasks):
    with children("tests.odd_child", tasks) as started:
        return list(answers(started, 60.0))


def test_facts_and_arrays_arrive_bit_by_bit():
    first, second = answered({"do": "measure", "length": 200_000})  # more than a pipe holds
    assert first.facts == {"pi": np.pi, "name": "ψ"}
    assert first.arrays["third"].tobytes() == np.full(200_000, 1 / 3).tobytes()
    assert first.arrays["square"].tolist() == [[0, 2], [1, 3]]
    assert first.arrays["square"].dtype == np.int16
    assert (second.facts, second.arrays) == ({}, {})


def test_an_answer_says_whose_it_is():
    found = answered({"do": "measure", "length": 1}, {"do": "chatter"})
    assert {answer.child for answer in found if "pi" in answer.facts} == {0}
    assert {answer.child for answer in found if "read" in answer.facts} == {1}


def test_a_task_may_be_longer_than_a_pipe_holds():
    (answer,) = answered({"do": "chatter", "ballast": "x" * 1_000_000})
    assert answer.facts == {"read": ""}


def test_what_a_child_prints_is_no_answer_and_what_it_reads_is_not_its_task(capfd):
    (answer,) = answered({"do": "chatter"})
    assert answer.facts == {"read": ""}
    printed = capfd.readouterr()
    assert printed.out == ""
    assert "said on stdout" in printed.err
    assert "and past Python" in printed.err


def test_a_child_that_ends_before_its_last_answer_has_died_whatever_its_exit_code():
    with children("tests.odd_child", [{"do": "die"}]) as started:
        found = answers(started, 60.0)
        assert next(found).facts == {"half": 1}
        with pytest.raises(EOFError):
            next(found)


def test_silence_is_an_error_after_some_patience():
    with children("tests.odd_child", [{"do": "wait"}]) as started:
        found = answers(started, 60.0)
        assert next(found).facts == {"ready": True}
        with pytest.raises(TimeoutError):
            next(answers(started, 0.2))


def test_a_child_that_waits_goes_when_it_is_told():
    with children("tests.odd_child", [{"do": "wait"}] * 2) as started:
        found = answers(started, 60.0)
        assert [next(found).facts for _ in range(2)] == [{"ready": True}] * 2
        started[1].go()
        assert (gone := next(found)).facts == {"gone": True}
        assert gone.child == 1


def test_children_are_deaf_to_ctrl_c_and_end_with_the_block():
    before = set(descendants(os.getpid()))
    with children("tests.odd_child", [{"do": "wait"}] * 2) as started:
        ours = set(descendants(os.getpid())) - before
        assert len(ours) == 2
        assert {os.getsid(pid) for pid in ours} == ours  # a terminal's Ctrl-C is for one session
        next(answers(started, 60.0))
    assert not any(map(is_alive, ours))


@contextmanager
def running(source):
    """A Python process that has printed a line and started two children, and they."""
    words = [sys.executable, "-c", textwrap.dedent(source)]
    ours: list[int] = []
    with subprocess.Popen(words, stdout=PIPE, stderr=PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "now\n"
            wait_until(lambda: len(descendants(process.pid)) == 2, "two children")
            ours += descendants(process.pid)
            yield process, ours
        finally:
            for pid in filter(is_alive, [process.pid, *ours]):
                os.kill(pid, signal.SIGKILL)


LEARNING = """
    from dppo.four_rooms.agent import Trial
    from dppo.four_rooms.processes import learn_on_cores
    from dppo.four_rooms.settings import AgentConfig
    from dppo.four_rooms.world import WorldConfig
    from dppo.process import leave

    trials = [Trial(AgentConfig(), number) for number in range(8)]
    events = learn_on_cores(WorldConfig(), trials, episodes=1_000_000, seed=0, jobs=2)

    def work():
        for _ in events:
            print("now", flush=True)

    leave(work)
"""
BENCH = """
    from dppo.process import leave
    from workers.bench import _on_all

    print("now", flush=True)
    leave(lambda: print(_on_all(2, "CartPole-v1", 1, 600.0)))
"""
READY = """
    from dppo.children import answers, children

    task = {"env_id": "CartPole-v1", "rows": 1, "seconds": 600.0}
    with children("workers.bench_process", [task] * 2) as started:
        found = answers(started)
        next(found), next(found)
        print("now", flush=True)
        next(found)
"""
STEPPING = READY.replace("print(", "[child.go() for child in started]; print(")


@pytest.mark.parametrize(
    "source",
    [LEARNING, BENCH, READY, STEPPING],
    ids=["learning", "just started", "waiting for the others", "stepping"],
)
def test_kill_9_of_the_parent_leaves_no_child(source):
    with running(source) as (process, ours):
        process.kill()
        wait_until(lambda: not any(map(is_alive, ours)), "the children to end", SOON)


@pytest.mark.parametrize(
    ("source", "sentence"),
    [
        (LEARNING, "a process of the experiment has died, perhaps for lack of memory"),
        (BENCH, "2 processes were started to step CartPole-v1, and one of them has died"),
    ],
    ids=["four-rooms", "bench"],
)
def test_a_child_that_dies_is_a_sentence_and_takes_the_others_along(source, sentence):
    with running(source) as (process, ours):
        os.kill(ours[0], signal.SIGKILL)
        _, errors = process.communicate(timeout=60)
        assert process.returncode == 1
        assert f"error: {sentence}" in errors
        assert "Traceback" not in errors
        assert not any(map(is_alive, ours))


@pytest.mark.slow
def test_no_process_of_the_bench_steps_before_all_are_ready():
    task = {"env_id": "CartPole-v1", "rows": 1, "seconds": 0.01}
    with children("workers.bench_process", [task] * 2) as started:
        found = answers(started, 60.0)
        assert [next(found).facts for _ in range(2)] == [{"ready": True}] * 2
        with pytest.raises(TimeoutError):
            next(answers(started, 0.5))
