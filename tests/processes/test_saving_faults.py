"""Whatever stops a save, at whichever call: the old or the new checkpoint is there, whole."""

import contextlib
import json
import os
import shutil
import subprocess
import sys

import numpy as np
import pytest

from dppo.errors import UsageError
from dppo.files import replace_durably
from dppo.store.checkpoint import (
    Checkpoint,
    best_name,
    load_checkpoint,
    mark_best,
    name_of,
    names,
    newest_checkpoint,
    prune,
    save_checkpoint,
)
from dppo.store.run_directory import RunDirectory
from tests.faulty_disk import WAYS, FaultyDisk, interrupted
from tests.support import ROOT


@pytest.fixture(autouse=True)
def unflushed(monkeypatch):
    """Flushing takes most of the time, and no machine really stops here."""
    monkeypatch.setattr(os, "fsync", lambda _handle: None)


def numbered(iteration):
    return Checkpoint({"parameters": np.arange(60.0) + iteration}, {"iteration": iteration})


def whole_save(folder, iteration):
    """All that happens at a checkpoint time."""
    save_checkpoint(folder, name_of(iteration), numbered(iteration))
    mark_best(folder, name_of(iteration), float(iteration))
    prune(folder, 1)


def spoil(folder, iteration):
    (folder / name_of(iteration) / "arrays.safetensors").write_bytes(b"torn")


def loaded(folder):
    """Iteration of the newest checkpoint, which holds what was saved; None if there is none."""
    found = newest_checkpoint(folder)
    if found is None:
        return None
    iteration = found.facts["iteration"]
    assert np.array_equal(found.arrays["parameters"], numbered(iteration).arrays["parameters"])
    return iteration


def no_checkpoint(folder):
    """Nothing yet."""


def one_checkpoint(folder):
    whole_save(folder, 1)


def a_corrupt_one_in_the_way(folder):
    save_checkpoint(folder, name_of(1), numbered(1))
    save_checkpoint(folder, name_of(2), numbered(2))
    spoil(folder, 2)


def a_corrupt_one_and_one_set_aside(folder):
    a_corrupt_one_in_the_way(folder)
    newest_checkpoint(folder)
    save_checkpoint(folder, name_of(2), numbered(2))
    spoil(folder, 2)


def the_same_one(folder):
    save_checkpoint(folder, name_of(1), numbered(1))
    save_checkpoint(folder, name_of(2), numbered(2))


def drafts_of_killed_learners(folder):
    one_checkpoint(folder)
    shutil.copytree(folder / name_of(1), folder / f".{name_of(2)}.{os.getpid()}")
    shutil.copytree(folder / name_of(1), folder / f".{name_of(1)}.old")


BEFORE = {
    no_checkpoint: {None, 2},
    one_checkpoint: {1, 2},
    a_corrupt_one_in_the_way: {1, 2},
    a_corrupt_one_and_one_set_aside: {1, 2},
    the_same_one: {2},
    drafts_of_killed_learners: {1, 2},
}


CASES = [(before, way, 28) for before in BEFORE for way in WAYS] + [
    (one_checkpoint, "fails on", 5), (one_checkpoint, "fails on", 30),
    (one_checkpoint, "fails once", 122),
]  # fmt: skip
FAST_WAYS = ("power cut", "fails once")
"""In the fast tier, whatever was there before; all ways with one checkpoint."""


@pytest.mark.parametrize(
    ("before", "way", "errno"),
    [
        pytest.param(
            *case,
            id=f"{case[0].__name__}, {case[1]}, {case[2]}",
            marks=[] if case[0] is one_checkpoint or case[1] in FAST_WAYS else pytest.mark.slow,
        )
        for case in CASES
    ],
)
def test_the_old_or_the_new_one_loads_and_the_next_save_works(tmp_path, before, way, errno):
    folder, found = tmp_path / "checkpoints", set()

    def begin_anew():
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        before(folder)

    begin_anew()
    for _ in interrupted(lambda: whole_save(folder, 2), way, errno):
        note = folder / "best.json"
        assert not note.exists() or json.loads(note.read_text())["episode_return_mean"] in (1, 2)
        found.add(loaded(folder))
        whole_save(folder, 3)
        assert loaded(folder) == 3
        assert best_name(folder) == name_of(3)
        left = [path.name for path in folder.iterdir() if not path.name.startswith("corrupt-")]
        assert sorted(left) == ["best.json", name_of(3)]
        begin_anew()
    assert found == BEFORE[before]


def test_what_is_said_to_be_saved_is_flushed(tmp_path, monkeypatch):
    disk = FaultyDisk(monkeypatch, at=0, way="fails once")
    whole_save(tmp_path, 1)
    assert disk.calls.count("fsync") >= 5  # two files and a note, and the folders they are in
    assert disk.unflushed == {}


def test_a_full_disk_leaves_no_draft_behind(tmp_path):
    for disk in interrupted(lambda: whole_save(tmp_path, 2), "fails once"):
        left = [path.name for path in tmp_path.iterdir() if path.name.startswith(".")]
        assert left == [] or disk.calls[-1] in ("unlink", "rmdir", "scandir", "close")


def test_one_that_verifies_is_never_replaced(tmp_path):
    saved = save_checkpoint(tmp_path, name_of(2), numbered(2))
    before = (saved / "manifest.json").stat()
    assert save_checkpoint(tmp_path, name_of(2), numbered(2)) == saved
    after = (saved / "manifest.json").stat()
    assert (before.st_ino, before.st_mtime_ns) == (after.st_ino, after.st_mtime_ns)


@pytest.mark.parametrize("way", WAYS)
def test_what_is_pruned_never_keeps_its_name_in_part(tmp_path, way):
    def begin_anew():
        shutil.rmtree(tmp_path / "checkpoints", ignore_errors=True)
        for iteration in (1, 2, 3, 4):
            save_checkpoint(tmp_path / "checkpoints", name_of(iteration), numbered(iteration))

    begin_anew()
    for _ in interrupted(lambda: prune(tmp_path / "checkpoints", 2), way):
        for name in names(tmp_path / "checkpoints"):
            load_checkpoint(tmp_path / "checkpoints" / name)
        prune(tmp_path / "checkpoints", 2)
        assert names(tmp_path / "checkpoints") == [name_of(3), name_of(4)]
        assert len(list((tmp_path / "checkpoints").iterdir())) == 2
        begin_anew()


@pytest.mark.parametrize("way", WAYS)
def test_a_small_file_is_the_old_or_the_new_one(tmp_path, way):
    file, found = tmp_path / "result.json", set()
    file.write_text("old")
    for _ in interrupted(lambda: replace_durably(file, b"the new one"), way):
        found.add(file.read_text())
        replace_durably(file, b"old")
        assert [path.name for path in tmp_path.iterdir()] == ["result.json"]
    assert found == {"old", "the new one"}


@pytest.mark.parametrize("way", WAYS)
def test_the_generation_never_falls(tmp_path, way):
    folder = RunDirectory.open(tmp_path)
    newest = folder.next_generation()
    begun: list[int] = []

    def begin():
        with contextlib.suppress(UsageError):
            begun.append(folder.next_generation())

    for _ in interrupted(begin, way):
        generation = folder.next_generation()
        assert generation > max([newest, *begun])
        newest = generation
    assert begun


def test_a_transient_error_while_reading_costs_no_checkpoint(tmp_path, monkeypatch):
    for iteration in (1, 2):
        save_checkpoint(tmp_path, name_of(iteration), numbered(iteration))
    real = type(tmp_path).read_bytes
    failed: list[object] = []

    def once(path):
        if not failed:
            failed.append(path)
            raise OSError(5, "Input/output error")
        return real(path)

    monkeypatch.setattr(type(tmp_path), "read_bytes", once)
    assert loaded(tmp_path) == 2
    assert len(failed) == 1


SAVER = """
import sys
from pathlib import Path
import numpy as np
from dppo.store.checkpoint import Checkpoint, mark_best, name_of, prune, save_checkpoint
folder = Path(sys.argv[1])
for iteration in (2, 3):
    checkpoint = Checkpoint({"parameters": np.arange(60.0) + iteration}, {"iteration": iteration})
    save_checkpoint(folder, name_of(iteration), checkpoint)
    mark_best(folder, name_of(iteration), float(iteration))
    prune(folder, 1)
"""
"""`whole_save` twice, in a process that imports little, so that its calls have fixed numbers."""


def strace_works():
    command = ["strace", "-f", "-qq", "-e", "trace=write", "-e", "inject=write:signal=KILL:when=1"]
    try:
        done = subprocess.run(
            [*command, "echo", "x"], capture_output=True, timeout=30, check=False
        )
    except FileNotFoundError:
        return False
    return done.returncode != 0 and done.stdout == b""


def killed_at(call, number, folder):
    """Run SAVER under strace; kill it at the `number`-th `call`, 0: never; what it called."""
    kill = ["-e", f"inject={call}:signal=KILL:when={number}"] if number else []
    trace = folder.parent / "trace"
    done = subprocess.run(
        ["strace", "-f", "-qq", "-y", "-o", trace, "-e", f"trace={call}", *kill,
         sys.executable, "-c", SAVER, folder],
        env=os.environ | {"PYTHONPATH": str(ROOT), "PYTHONDONTWRITEBYTECODE": "1"},
        cwd=ROOT, capture_output=True, timeout=60, check=False,
    )  # fmt: skip
    assert (done.returncode == 0) == (number == 0), done.stderr.decode()
    lines = [line.split(maxsplit=1) for line in trace.read_text().splitlines()]
    thread = next((number for number, what in lines if str(folder) in what), None)
    return [what for number, what in lines if number == thread and what.startswith(f"{call}(")]


@pytest.mark.slow
@pytest.mark.parametrize(
    "call", ["write", "fsync", "rename", "mkdir", "unlinkat", "rmdir", "openat", "close"]
)
def test_a_real_kill_at_every_call_of_a_save_leaves_a_loadable_folder(tmp_path, call):
    if not strace_works():
        pytest.skip("strace is not there, or cannot inject a signal here")
    folder = tmp_path / "checkpoints"

    def begin_anew():
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        a_corrupt_one_in_the_way(folder)

    begin_anew()
    calls = killed_at(call, 0, folder)
    ours = [number for number, line in enumerate(calls, 1) if str(folder) in line]
    assert ours, calls[-5:]
    found = []
    for number in ours:
        begin_anew()
        killed_at(call, number, folder)
        found.append(loaded(folder))
        whole_save(folder, 4)
        assert loaded(folder) == 4
    assert set(found) <= {1, 2, 3}
    assert found == sorted(found)
    assert len(set(found)) > 1
