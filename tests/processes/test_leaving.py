"""How a command ends after signals."""

import os
import signal
import subprocess
import sys

import pytest

from dppo.__main__ import _is_open_ended
from tests.support import ROOT

COMMAND = """
import sys
import time
from dppo import process

process._TIDY_SECONDS = float(sys.argv[1])


def work():
    try:
        print("ready", flush=True)
        time.sleep(60)
    finally:
        print("tidying up", flush=True)
        sys.stdin.readline()
        print("tidy", flush=True)
    return 0


process.leave(work, delivers=len(sys.argv) > 2)
"""


EARLY = """
import os
import signal
import sys
import time
from dppo import process


def come(*_args):
    os.kill(os.getpid(), signal.{name})


def work():
    import greedy

    print("went on", flush=True)
    time.sleep(60)
    return 0


if sys.argv[1] == "import":
    sys.come = come
else:
    sys.setswitchinterval = come
process.leave(work, delivers=True)
"""
GREEDY = """
import sys

try:
    sys.come()
    sum(range(1000))  # signals are looked at between two steps of the interpreter
except BaseException:
    pass
"""


@pytest.mark.parametrize("when", ["import", "start"])
@pytest.mark.parametrize(("name", "code"), [("SIGINT", 130), ("SIGTERM", 143)])
def test_a_signal_is_not_lost_that_comes_in_the_first_moments(when, name, code, tmp_path):
    """Libraries swallow what is raised while they are imported: the command would go on."""
    (tmp_path / "greedy.py").write_text(GREEDY)
    found = subprocess.run(
        [sys.executable, "-c", EARLY.format(name=name), when],
        cwd=ROOT, env=os.environ | {"PYTHONPATH": f"{ROOT}:{tmp_path}"}, timeout=50, check=False,
        capture_output=True, text=True, restore_signals=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )  # fmt: skip
    assert found.returncode == code
    assert found.stderr == f"stopped by {name}; the result is not complete\n"


def test_an_import_that_does_not_end_is_interrupted(tmp_path):
    (tmp_path / "greedy.py").write_text("import sys\nimport time\nsys.come()\ntime.sleep(60)\n")
    command = EARLY.format(name="SIGTERM").replace(
        "def come", "process._IMPORT_SECONDS = 0.2\ndef come"
    )
    found = subprocess.run(
        [sys.executable, "-c", command, "import"],
        cwd=ROOT, env=os.environ | {"PYTHONPATH": f"{ROOT}:{tmp_path}"}, timeout=50, check=False,
        capture_output=True, text=True,
    )  # fmt: skip
    assert found.returncode == 143


@pytest.fixture
def started():
    """A command that tidies up until it reads a line.

    How long it may, before a signal ends it; and a word if it is to deliver something.
    """
    children = []

    def start(seconds, *words):
        child = subprocess.Popen(
            [sys.executable, "-c", COMMAND, str(seconds), *words],
            cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
            text=True, restore_signals=True,
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
        )  # fmt: skip
        children.append(child)
        assert child.stdout is not None
        assert child.stdout.readline() == "ready\n"
        return child

    yield start
    for child in children:
        child.kill()
        child.communicate()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_first_signal_ends_it_and_later_ones_let_it_tidy_up(started, number):
    child = started(60)
    child.send_signal(number)
    assert child.stdout.readline() == "tidying up\n"
    for later in (signal.SIGINT, signal.SIGTERM, signal.SIGTERM, signal.SIGINT):
        child.send_signal(later)
    out, err = child.communicate("\n", timeout=10)
    assert (out, err, child.returncode) == ("tidy\n", "", 0)


def test_tidying_up_that_takes_too_long_is_cut_short_by_a_second_signal(started):
    child = started(0)
    child.send_signal(signal.SIGTERM)
    assert child.stdout.readline() == "tidying up\n"
    child.send_signal(signal.SIGTERM)
    assert child.wait(10) == 128 + signal.SIGTERM


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_command_that_delivers_something_does_not_end_as_if_it_had(started, number):
    child = started(60, "delivers")
    child.send_signal(number)
    assert child.stdout.readline() == "tidying up\n"
    out, err = child.communicate("\n", timeout=10)
    sentence = f"stopped by {number.name}; the result is not complete\n"
    assert (out, err, child.returncode) == ("tidy\n", sentence, 128 + number)


@pytest.mark.parametrize(
    ("words", "open_ended"),
    [
        ("watch runs/ant", True), ("experiment table2", True), ("experiment grid.toml", True),
        ("experiment report runs/grid", False), ("experiment keep runs/grid --out a", False),
        ("eval runs/ant", False), ("", False),
    ],
)  # fmt: skip
def test_what_delivers_something_is_every_command_but_watching_and_a_grid(words, open_ended):
    assert _is_open_ended(words.split()) == open_ended
