"""What a benchmark has started is gone afterwards, however it was started and however it ends."""

import os
import signal
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

from benchmarks.processes import started
from benchmarks.runs import Run
from tests.support import wait_until

STUBBORN = textwrap.dedent(
    """
    import os, signal, subprocess, sys, time

    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    file, depth = sys.argv[1], int(sys.argv[2])
    if depth:
        words = [sys.executable, "-S", "-c", os.environ["STUBBORN"], file, str(depth - 1)]
        subprocess.Popen(words, start_new_session=True)
    with open(file, "a") as pids:
        pids.write(f"{os.getpid()}\\n")
    if not (depth == 1 and os.environ.get("ORPHAN")):
        time.sleep(60)
    """
)
"""Ignores SIGTERM and starts another of its kind in a session of its own, `depth` times."""
THREE = 3


def words(file):
    return [sys.executable, "-S", "-c", STUBBORN, str(file), str(THREE - 1)]


def pids_in(file, count=THREE):
    """The processes that have noted themselves, once all have."""
    wait_until(
        lambda: file.exists() and len(file.read_text().splitlines()) >= count,
        f"{count} processes to note themselves",
    )
    return [int(line) for line in file.read_text().splitlines()]


def living(pids):
    """Those that are neither gone nor waiting to be reaped by somebody."""
    found = []
    for pid in pids:
        try:
            stat = Path(f"/proc/{pid}/stat").read_text()
        except OSError:
            continue
        if stat.rpartition(")")[2].split()[0] not in "ZX":
            found.append(pid)
    return found


@pytest.fixture
def file(tmp_path):
    file = tmp_path / "pids"
    yield file
    for pid in living(pids_in(file, 0) if file.exists() else []):
        os.kill(pid, signal.SIGKILL)


def test_children_that_ignore_sigterm_in_sessions_of_their_own_are_gone(file):
    tree = started(words(file), {"STUBBORN": STUBBORN})
    pids = pids_in(file)
    assert len(living(pids)) == THREE
    tree.end(patience=0.1)
    assert living(pids) == []


def test_children_of_a_process_that_has_ended_before_are_gone(file):
    tree = started(words(file), {"STUBBORN": STUBBORN, "ORPHAN": "1"})
    pids = pids_in(file)
    wait_until(lambda: len(living(pids)) < THREE, "the one in the middle to end by itself")
    tree.end()
    assert living(pids) == []


def test_a_process_without_the_mark_is_found_by_its_parents(file):
    clean = ["env", "-u", "DPPO_BENCHMARK", *words(file)]
    tree = started(clean, {"STUBBORN": STUBBORN})
    pids = pids_in(file)
    tree.end()
    assert living(pids) == []


def test_ctrl_c_ends_a_run(file, monkeypatch):
    monkeypatch.setenv("STUBBORN", STUBBORN)

    def interrupted():
        with Run(lambda _: words(file), patience=0.1):
            pids_in(file)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert living(pids_in(file)) == []


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_what_a_benchmark_leaves_when_it_is_cut_off_is_gone(file, number):
    benchmark = textwrap.dedent(
        f"""
        import time
        from benchmarks.processes import started
        started({words(file)!r}, {{"STUBBORN": {STUBBORN!r}}}, start_new_session=True)
        time.sleep(60)
        """
    )
    env = {k: v for k, v in os.environ.items() if k not in ("DPPO_BENCHMARK", "PYTHONPATH")}
    root = Path(__file__).parents[2]
    with subprocess.Popen(
        [sys.executable, "-c", benchmark], env=env, cwd=root, stderr=subprocess.PIPE
    ) as process:
        pids = pids_in(file)
        process.send_signal(number)
        process.communicate(timeout=30)  # the guard, and what it has to end, hold stderr open
    assert living(pids) == []
