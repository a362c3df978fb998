"""Growing files and checkpoints on a disk that fails, fills up, hangs, and comes back."""

import contextlib
import json
import logging
import os
from pathlib import Path

import pytest

from dppo.process import say
from dppo.store.ledger import IterationLine
from learner import disk as disk_module
from learner.disk import Disk, GrowingFile
from learner.logfile import FileHandler
from learner.report import IterationReport
from learner.runlog import RunLog
from tests.faulty_disk import FaultyDisk, interrupted

LINES = [b'{"iteration": %d}\n' % number for number in range(1, 7)]


def no_one():
    """Is told of changes."""


def written(disk):
    """Let the disk's thread do all that it was given."""
    disk.run(lambda: None).result(10)


def report(iteration):
    return IterationReport(
        iteration=iteration, env_steps=10 * iteration, metrics={"train/kl": 0.5 * iteration}
    )


def measured(unsaved):
    """Figures that depend on how it ran."""
    return {
        "charts/SPS": 1.0, "cluster/round_ms": 1.0, "cluster/unsaved_iterations": float(unsaved)
    }  # fmt: skip


def iterations_in(file):
    return [json.loads(line)["iteration"] for line in file.read_text().splitlines()]


def tried(file, lines):
    """Each line is tried at once, as in an iteration; a failure ends nothing."""
    for line in lines:
        file.write(line)
        with contextlib.suppress(OSError):
            file.write_out()


@pytest.mark.parametrize("way", ["fails once", "fails on"])
@pytest.mark.parametrize("errno", [28, 30, 5, 122])
def test_each_line_is_there_once_whichever_call_fails(tmp_path, way, errno):
    path, files = tmp_path / "metrics.jsonl", []

    def work():
        files.append(GrowingFile(path, 0, no_one))
        tried(files[-1], LINES[:4])

    for disk in interrupted(work, way, errno):
        there = path.read_bytes() if path.exists() else b""
        assert b"".join(LINES).startswith(there)
        if "ftruncate" not in disk.calls:
            assert there.endswith(b"\n") or there == b""
        tried(files[-1], LINES[4:])
        assert path.read_bytes() == b"".join(LINES)
        path.unlink()
    assert len(files) > 8


@pytest.mark.parametrize("way", ["killed", "killed half-way"])
def test_a_kill_at_any_call_leaves_lines_that_the_next_learner_goes_on_from(tmp_path, way):
    path, found = tmp_path / "metrics.jsonl", set()
    for _ in interrupted(lambda: tried(GrowingFile(path, 0, no_one), LINES[:3]), way):
        runlog = RunLog(tmp_path, 3, Disk(tmp_path, "logs"))
        runlog.close()
        kept = iterations_in(path) if path.exists() else []
        found.add(len(kept))
        for iteration in range(len(kept) + 1, 5):
            runlog.write(report(iteration), measured(0))
        runlog.close()
        assert iterations_in(path) == [1, 2, 3, 4]
        for file in tmp_path.iterdir():
            file.unlink()
    assert found == {0, 1, 2, 3}


def test_a_full_disk_is_said_once_and_so_is_its_recovery(tmp_path, monkeypatch, caplog):
    disk = Disk(tmp_path, "the run's logs")
    runlog = RunLog(tmp_path, 0, disk)
    written(disk)
    with caplog.at_level(logging.WARNING, "disk"):
        with monkeypatch.context() as patch:
            FaultyDisk(patch, at=1, way="fails on")
            for iteration in (1, 2, 3):
                runlog.write(report(iteration), measured(0))
                written(disk)
        assert caplog.text.count("the run's logs in") == 1
        assert f"{tmp_path} cannot be written: [Errno 28] No space left on device" in caplog.text
        runlog.write(report(4), measured(4))
        runlog.note(IterationLine(iteration=4, parameters_sha256="9c1e"))
        runlog.close()
    assert caplog.text.count("the run's logs are written again") == 1
    assert "Traceback" not in caplog.text
    assert iterations_in(tmp_path / "metrics.jsonl") == [1, 2, 3, 4]
    last = json.loads((tmp_path / "metrics.jsonl").read_text().splitlines()[-1])
    assert last["cluster/unsaved_iterations"] == 4
    table = (tmp_path / "progress.csv").read_text().splitlines()
    assert [row.split(",")[0] for row in table] == ["iteration", "1", "2", "3", "4"]
    assert iterations_in(tmp_path / "ledger.jsonl") == [4]
    assert scalars(tmp_path) == [(10, 0.5), (20, 1.0), (30, 1.5), (40, 2.0)]


def scalars(folder):
    """Steps and values of one metric, as TensorBoard reads them."""
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    board = EventAccumulator(str(folder))
    board.Reload()
    return [(event.step, event.value) for event in board.Scalars("train/kl")]


def test_lines_that_are_not_on_the_disk_in_the_end_are_counted(tmp_path, monkeypatch, caplog):
    disk = Disk(tmp_path, "the run's logs")
    file = disk.file("metrics.jsonl", 0)
    FaultyDisk(monkeypatch, at=1, way="fails on", errno=30)
    for line in LINES:
        file.write(line)
    disk.settle()
    assert "6 lines of the run's logs are still not on the disk" in caplog.text


def test_memory_is_bounded_and_the_loss_is_said(tmp_path, monkeypatch, caplog):
    """Six lines of 17 bytes, room for three."""
    monkeypatch.setattr(disk_module, "MOST_WAITING", 3 * 17)
    disk = Disk(tmp_path, "the run's logs")
    file = disk.file("metrics.jsonl", 0)
    with monkeypatch.context() as patch:
        FaultyDisk(patch, at=1, way="fails on")
        for line in LINES:
            file.write(line)
        written(disk)
    disk.settle()
    assert "written again; 3 lines were too many to keep and are lost" in caplog.text
    assert (tmp_path / "metrics.jsonl").read_bytes() == b"".join(LINES[3:])


def test_a_disk_that_hangs_stops_neither_the_run_nor_its_log(tmp_path):
    """A named pipe blocks whoever opens it until somebody reads."""
    disk = Disk(tmp_path, "the run's logs")
    runlog = RunLog(tmp_path, 0, disk)
    written(disk)
    (tmp_path / "metrics.jsonl").unlink(missing_ok=True)
    os.mkfifo(tmp_path / "metrics.jsonl")
    os.mkfifo(tmp_path / "log.txt")
    handler = FileHandler(tmp_path / "log.txt")
    for iteration in range(1, 1001):
        runlog.write(report(iteration), measured(0))
        handler.handle(logging.makeLogRecord({"msg": "slow", "levelno": logging.WARNING}))
    stuck = disk.run(lambda: None)
    assert not stuck.done()
    readers = [os.open(tmp_path / name, os.O_RDONLY) for name in ("metrics.jsonl", "log.txt")]
    stuck.result(10)
    for name in ("metrics.jsonl", "log.txt"):  # a pipe takes no lines at a place: a file again
        (tmp_path / name).unlink()
    runlog.close()
    handler.settle()
    for reader in readers:
        os.close(reader)
    assert iterations_in(tmp_path / "metrics.jsonl") == list(range(1, 1001))
    assert (tmp_path / "log.txt").read_text() == "slow\n" * 1000


def test_log_lines_on_a_full_disk_are_kept_and_print_nothing(tmp_path, monkeypatch, capfd):
    handler = FileHandler(tmp_path / "log.txt")
    with monkeypatch.context() as patch:
        FaultyDisk(patch, at=1, way="fails on")
        for text in ("one", "two"):
            handler.handle(logging.makeLogRecord({"msg": text}))
        handler.settle()
    handler.handle(logging.makeLogRecord({"msg": "three"}))
    handler.settle()
    assert (tmp_path / "log.txt").read_text() == "one\ntwo\nthree\n"
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("tail", "kept"),
    [
        (b"", [1, 2, 3]),
        (b'{"iteration": 4, "time/tot', [1, 2, 3]),
        (b'{"iteration": 4, "time/total_timesteps": 40}', [1, 2, 3, 4]),
        (b'{"iteration": 4, "time/total_timesteps": 40}\n{"iter', [1, 2, 3, 4]),
        (b'{"iteration": 5, "time/total_timesteps": 50}\n', [1, 2, 3]),
        (b"\x00" * 40, [1, 2, 3]),
        (b"[4]\n", [1, 2, 3]),
        (b"{}\n", [1, 2, 3]),
    ],
    ids=["whole", "torn", "no end", "torn after", "beyond", "zeros", "list", "empty"],
)
def test_a_resumed_run_cuts_what_is_torn_or_will_be_run_again(tmp_path, tail, kept):
    rows = [{"iteration": number, "time/total_timesteps": 10 * number} for number in (1, 2, 3)]
    text = b"".join(json.dumps(row).encode() + b"\n" for row in rows)
    (tmp_path / "metrics.jsonl").write_bytes(text + tail)
    disk = Disk(tmp_path, "logs")
    runlog = RunLog(tmp_path, 4, disk)
    runlog.write(report(5), measured(0))
    runlog.close()
    assert iterations_in(tmp_path / "metrics.jsonl") == [*kept, 5]
    table = (tmp_path / "progress.csv").read_text().splitlines()
    assert [row.split(",")[0] for row in table[1:]] == [str(number) for number in [*kept, 5]]


@pytest.mark.parametrize("damage", [b"\n", b'{"iteration": 2, "ti\n', b"\x00\x01\n"])
def test_a_line_that_was_damaged_between_others_costs_no_other_line(tmp_path, damage, caplog):
    first, second = (
        json.dumps({"iteration": number, "time/total_timesteps": 10 * number}).encode() + b"\n"
        for number in (1, 3)
    )
    (tmp_path / "metrics.jsonl").write_bytes(first + damage + second)
    disk = Disk(tmp_path, "logs")
    runlog = RunLog(tmp_path, 3, disk)
    runlog.close()
    assert (tmp_path / "metrics.jsonl").read_bytes() == first + damage + second
    assert "cannot read 1 of the lines of" in caplog.text
    table = (tmp_path / "progress.csv").read_text().splitlines()
    assert [row.split(",")[0] for row in table[1:]] == ["1", "3"]


def test_a_file_that_somebody_emptied_goes_on_without_a_hole(tmp_path):
    disk = Disk(tmp_path, "logs")
    file = disk.file("log.txt", 0)
    for line in LINES[:2]:
        file.write(line)
    disk.settle()
    os.truncate(tmp_path / "log.txt", 0)
    file.write(LINES[2])
    disk.settle()
    assert (tmp_path / "log.txt").read_bytes() == LINES[2]


def test_no_file_is_left_open(tmp_path):
    disk = Disk(tmp_path, "logs")
    runlog = RunLog(tmp_path, 0, disk)
    runlog.write(report(1), measured(0))
    runlog.close()
    handles = Path("/proc/self/fd").iterdir()
    targets = [str(handle.readlink()) for handle in handles if handle.is_symlink()]
    assert targets
    assert not [target for target in targets if target.startswith(str(tmp_path))]


def test_output_that_is_on_the_full_disk_costs_lines_and_not_the_run(monkeypatch):
    with Path("/dev/full").open("w") as full:
        monkeypatch.setattr("sys.stdout", full)
        for _ in range(1000):
            say("a line of output that a full disk does not take")
        monkeypatch.undo()
        with contextlib.suppress(OSError):
            full.close()
