"""The learner's own workers: what hangs, cannot start, or is left over."""

import contextlib
import errno
import os
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import pytest

from dppo.machine import own_program
from dppo.wire.memory_links import MemoryHub
from dppo.wire.socket_links import Alarm, SocketLearnerLink
from learner import local
from learner.local import LocalWorkers
from tests.support import ROOT, SMALL, descendants, is_alive, iterations, state_of, wait_until

pytestmark = pytest.mark.slow


@pytest.fixture
def workers():
    """One worker, which says Hello again and again since nobody welcomes it."""
    link = SocketLearnerLink(MemoryHub().learner(), Alarm())
    found = LocalWorkers(link, count=1, verbose=False, most_silent=3.0)
    yield found
    found.end()


def looked_after(workers, fact, what):
    """As a learner does: listen, and look after them."""

    def look():
        workers.link.receive(0.05)
        workers.look_after()
        return fact()

    wait_until(look, what)


def pids(workers):
    return {child.process.pid for child in workers._children.values() if child is not None}


def open_files():
    return len(list(Path("/proc/self/fd").iterdir()))


@pytest.mark.parametrize(
    ("count", "cores", "own"),
    [(2, 2, [0, 1]), (3, 3, [0, 1, 2]), (2, 3, [-1, -1]), (3, 2, [-1, -1, -1]), (1, 1, [-1])],
)
def test_each_has_a_core_of_its_own_where_there_are_as_many_as_cores(
    monkeypatch, count, cores, own
):
    monkeypatch.setattr(local, "usable_cores", lambda: cores)
    link = SocketLearnerLink(MemoryHub().learner(), Alarm())
    workers = LocalWorkers(link, count=count, verbose=False)
    assert [workers._core(index) for index in range(count)] == own


def test_one_that_stops_before_it_has_joined_is_replaced(workers, caplog):
    workers.start()
    (victim,) = pids(workers)
    os.kill(victim, signal.SIGSTOP)
    looked_after(workers, lambda: victim not in pids(workers), "another worker")
    assert not is_alive(victim)
    assert "local worker 0 has said nothing for 3 s; starting another in its place" in caplog.text


def test_one_that_is_heard_stays_however_long_it_waits(workers):
    workers.start()
    (pid,) = pids(workers)
    until = time.monotonic() + 2 * workers.most_silent
    looked_after(workers, lambda: time.monotonic() > until, "some time to pass")
    assert pids(workers) == {pid}


def test_no_room_for_a_process_is_waited_for(workers, monkeypatch, caplog):
    monkeypatch.setattr(local, "_AGAIN_SECONDS", 0.1)
    workers.start()
    (victim,) = pids(workers)
    attempts = []

    def no_room(*_args, **_options):
        attempts.append(1)
        raise OSError(errno.EAGAIN, "Resource temporarily unavailable")

    before = open_files()
    with monkeypatch.context() as full:
        full.setattr(subprocess, "Popen", no_room)
        os.kill(victim, signal.SIGKILL)
        looked_after(workers, lambda: len(attempts) > 2, "three attempts")
    assert "local worker 0 cannot be started: [Errno 11]" in caplog.text
    assert open_files() < before  # the old one's are closed, and no others left
    looked_after(workers, lambda: len(pids(workers)) == 1, "a worker")


def test_a_file_of_the_users_with_our_name_is_not_started(tmp_path):
    for name in ("workers", "learner", "dppo"):
        (tmp_path / f"{name}.py").write_text("print('not ours')")
        done = subprocess.run(
            own_program(name, "--help"), cwd=tmp_path, capture_output=True, text=True, check=True
        )
        assert "not ours" not in done.stdout
        assert "usage:" in done.stdout


@pytest.fixture
def on_cores():
    """What is started from here on may use so many of our cores."""
    mine = os.sched_getaffinity(0)

    def restrict(count):
        if len(mine) < count:
            pytest.skip(f"there are fewer than {count} cores")
        os.sched_setaffinity(0, sorted(mine)[:count])

    yield restrict
    os.sched_setaffinity(0, mine)


@pytest.mark.parametrize(("cores", "slots", "workers"), [(1, 8, 1), (2, 8, 2), (2, 1, 1)])
def test_without_a_number_there_is_one_worker_per_core_and_at_most_one_per_slot(
    harness, on_cores, cores, slots, workers
):
    on_cores(cores)
    run_dir = harness.folder / "run"
    learner = harness.learner(
        "--env", "CartPole-v1", *SMALL, "--slots", str(slots), run_dir=run_dir
    )
    wait_until(lambda: iterations(run_dir) >= 1, "an iteration")
    assert len(descendants(learner.popen.pid)) == workers
    assert f"; {workers} local workers; " in learner.text


def test_workers_that_work_keep_to_their_cores(harness, on_cores):
    """Each for half a second of work at least: beside something else it may let go again."""
    on_cores(2)
    endless = ("--env", "CartPole-v1", *SMALL, "--total-timesteps", "100000000")
    learner = harness.learner(*endless, run_dir=harness.folder / "run")
    seen = set()

    def all_were_seen_on_one():
        for pid in descendants(learner.popen.pid):
            with contextlib.suppress(OSError):
                seen.add((pid, frozenset(os.sched_getaffinity(pid))))
        return {cores for _, cores in seen if len(cores) == 1} == {
            frozenset([core]) for core in os.sched_getaffinity(0)
        }

    wait_until(all_were_seen_on_one, "each worker on a core of its own")
    for pid in {pid for pid, _ in seen}:
        assert len([cores for one, cores in seen if one == pid and len(cores) == 1]) <= 1


def test_a_worker_that_holds_the_interpreter_or_is_stopped_dies_with_its_learner():
    """The thread that sees the socket's end gone has no chance in either."""
    source = """
        import os, subprocess, sys, time
        child = "from dppo.machine import end_with_parent as e; e(); print(1, flush=True); "
        hang = "import re; re.match('(a+)+$', 60 * 'a' + 'b')"
        for rest in ("import time; time.sleep(600)", hang):
            words = [sys.executable, "-c", child + rest]
            subprocess.Popen(words, stdout=subprocess.PIPE).stdout.readline()
        print("now", flush=True)
        time.sleep(600)
    """
    words = [sys.executable, "-c", textwrap.dedent(source)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True, cwd=ROOT) as parent:
        assert parent.stdout is not None
        assert parent.stdout.readline() == "now\n"
        children = descendants(parent.pid)
        assert len(children) == 2
        os.kill(children[0], signal.SIGSTOP)
        wait_until(lambda: state_of(children[0]) == "T", "it to stop")
        parent.kill()
        wait_until(lambda: not any(map(is_alive, children)), "both to end", 10.0)
