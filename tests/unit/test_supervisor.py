"""When a learner is started again, and what is said about it. No process is started here."""

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from learner.supervisor import Supervision, exit_code, signal_name

ROOT = Path(__file__).parents[2]
KILLED = -int(signal.SIGKILL)


@pytest.mark.parametrize("code", [0, 2])
def test_what_is_over_or_would_end_so_again_is_not_started_again(code):
    supervision = Supervision(restarts=3)
    assert supervision.pause_after(code, lived=5.0) is None
    assert supervision.sentence(code, 5.0, None) == ""


@pytest.mark.parametrize("code", [1, 3, 137, KILLED, -int(signal.SIGSEGV)])
def test_a_failure_or_a_signal_is_started_again_n_times_in_all(code):
    supervision = Supervision(restarts=2)
    pauses = [supervision.pause_after(code, lived=1000.0) for _ in range(4)]
    assert [pause is not None for pause in pauses] == [True, True, False, False]
    assert supervision.used == 2


def test_wrong_usage_of_a_restart_is_not_final_something_else_is_in_the_way():
    supervision = Supervision(restarts=2)
    assert supervision.pause_after(KILLED, 5.0) is not None
    assert supervision.pause_after(2, 0.5) is not None
    assert supervision.sentence(2, 0.5, 1.0).startswith("the learner ended with exit code 2 after")
    assert supervision.pause_after(2, 0.5) is None
    assert "no restart is left" in supervision.sentence(2, 0.5, None)


def test_what_it_says_may_be_lost_and_it_starts_the_learner_all_the_same():
    learner = [sys.executable, "-c", "import os; os.write(1, b'.'); exit(3)"]
    program = f"from learner.supervisor import supervise; exit(supervise({learner}, [], 2))"
    words = [sys.executable, "-c", program]
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(words, cwd=ROOT, stdout=subprocess.PIPE, stderr=full, check=False)
    assert (done.stdout, done.returncode) == (b"...", 3)


def test_no_restarts_is_none():
    assert Supervision(restarts=0).pause_after(KILLED, 5.0) is None


def test_pauses_grow_with_jitter_up_to_a_bound_and_begin_anew_after_a_long_life():
    supervision = Supervision(restarts=100)
    full = [0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 30.0, 30.0]  # doubled up to 30 s
    for lived in (5.0, 61.0):
        pauses = [
            supervision.pause_after(1, lived),
            *(supervision.pause_after(1, 5.0) for _ in full[1:]),
        ]
        for pause, most in zip(pauses, full, strict=True):
            assert pause is not None
            assert most / 2 <= pause <= most


def test_a_restart_is_announced_with_its_cause_and_what_is_left():
    supervision = Supervision(restarts=3, used=1)
    assert supervision.sentence(KILLED, 12.34, 0.5) == (
        "the learner was ended by SIGKILL after 12.3 s; starting it again in 0.5 s, restart 1 of "
        "3, 2 left"
    )
    assert supervision.sentence(1, 4.0, 0.5).startswith("the learner ended with exit code 1 after")


def test_the_end_of_all_restarts_says_what_to_do():
    supervision = Supervision(restarts=1)
    assert supervision.pause_after(1, 4.0) is not None
    assert supervision.pause_after(1, 4.0) is None
    assert supervision.sentence(1, 4.0, None) == (
        "the learner ended with exit code 1 after 4.0 s; no restart is left of --restarts 1: see "
        "above for the cause; the same command with this --run-dir continues"
    )


def test_exit_codes_are_those_of_a_shell():
    assert [exit_code(code) for code in (0, 1, KILLED)] == [0, 1, 137]


def test_signals_have_names():
    assert (signal_name(9), signal_name(63)) == ("SIGKILL", "signal 63")


def test_the_supervisor_loads_nothing_heavy():
    """It stays beside the learner for the whole run."""
    program = (
        "import sys, learner.supervisor; print(*{name.split('.')[0] for name in sys.modules})"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True
    )
    loaded = set(done.stdout.split())
    assert {"learner", "dppo", "subprocess"} <= loaded
    assert loaded.isdisjoint({"numpy", "torch", "zenoh", "tyro", "mujoco", "msgpack"})
