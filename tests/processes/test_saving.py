"""Saving beside the training: a disk that fails or is slow costs checkpoints, never the run."""

import json
import logging
import threading

import numpy as np
import pytest

from dppo.config import Config
from dppo.errors import RunFailedError
from dppo.networks import Networks
from dppo.spaces import Spaces
from dppo.store.checkpoint import name_of, names, newest_checkpoint
from learner.disk import Disk
from learner.saving import Saving, insist
from learner.state import State
from tests.faulty_disk import FaultyDisk

SPACES = Spaces(obs_size=3, action_kind="box", action_sizes=(2,))


def state_at(iteration, mean=None):
    config = Config()
    state = State.initial(Networks.build(SPACES, config), SPACES.obs_size, config)
    episodes = np.empty((0, 2)) if mean is None else np.array([[mean, 10.0]])
    return State(
        **{name: getattr(state, name) for name in State.__dataclass_fields__}
        | {"iteration": iteration, "episodes": episodes}
    )


def saver(folder, pause=lambda _seconds: None):
    disk = Disk(folder, "the run's logs")
    return Saving(disk, folder / "checkpoints", 2, lambda state: {"steps": state.iteration}, pause)


def settled(saving):
    """Let it finish what it has begun, whether it works or not."""
    saving._settle()


def test_what_is_begun_is_on_the_disk_in_the_end_with_its_facts(tmp_path):
    saving = saver(tmp_path)
    assert saving.unsaved(3) == 3
    saving.begin(state_at(4))
    saving.finish(state_at(4))
    assert saving.unsaved(7) == 3
    found = newest_checkpoint(tmp_path / "checkpoints")
    assert found is not None
    assert found.facts["steps"] == 4
    assert State.from_checkpoint(found).iteration == 4


def test_attempts_are_made_with_growing_pauses_and_the_last_error_is_given():
    pauses: list[float] = []
    attempts: list[int] = []

    def fails():
        attempts.append(1)
        raise OSError(28, f"No space left, attempt {len(attempts)}")

    failure = insist(fails, pauses.append)
    assert str(failure) == "[Errno 28] No space left, attempt 4"
    assert pauses == sorted(pauses)
    assert len(set(pauses)) == 3
    assert sum(pauses) < 2


@pytest.mark.parametrize("errno", [28, 30, 5, 122])
def test_an_error_that_passes_is_not_even_said(tmp_path, monkeypatch, caplog, errno):
    saving = saver(tmp_path)
    FaultyDisk(monkeypatch, at=3, way="fails once", errno=errno)
    saving.begin(state_at(2))
    saving.finish(state_at(2))
    assert names(tmp_path / "checkpoints") == [name_of(2)]
    assert caplog.text == ""


@pytest.mark.parametrize(
    ("errno", "words"),
    [
        (28, "No space left on device.*; make room there"),
        (122, "Disk quota exceeded.*; make room there"),
        (30, "Read-only file system.*; see to the disk"),
        (5, "Input/output error.*; see to the disk"),
    ],
)
def test_a_disk_that_fails_is_said_once_and_tried_again(
    tmp_path, monkeypatch, caplog, errno, words
):
    saving = saver(tmp_path)
    with monkeypatch.context() as patch, caplog.at_level(logging.WARNING, "checkpoint"):
        FaultyDisk(patch, at=1, way="fails on", errno=errno)
        for iteration in (2, 4):
            saving.begin(state_at(iteration))
            settled(saving)
        assert saving.unsaved(5) == 5
    said = [record.getMessage() for record in caplog.records if record.name == "checkpoint"]
    assert len(said) == 1
    assert said[0].startswith(
        f"the checkpoint of iteration 2 in {tmp_path / 'checkpoints'} cannot be written: "
    )
    assert words.split(".*")[0] in said[0]
    assert said[0].endswith(words.split(".*")[1])
    saving.begin(state_at(6))
    settled(saving)
    assert "checkpoints are written again, up to iteration 6" in caplog.text
    assert saving.unsaved(6) == 0


def test_a_last_checkpoint_that_cannot_be_written_ends_the_run_with_a_sentence(
    tmp_path, monkeypatch, caplog
):
    saving = saver(tmp_path)
    saving.finish(state_at(2))
    with monkeypatch.context() as patch:
        FaultyDisk(patch, at=1, way="fails on")
        sentence = (
            "the checkpoint of iteration 3 in .* could not be written: .*No space left.*; make "
            "room there and start the same command again, it goes on from iteration 2"
        )
        with pytest.raises(RunFailedError, match=sentence):
            saving.finish(state_at(3))
    assert "goes on and tries again" not in caplog.text
    saving.finish(state_at(3))
    assert names(tmp_path / "checkpoints") == [name_of(2), name_of(3)]


def test_a_last_checkpoint_gets_another_chance_after_one_that_failed(tmp_path, monkeypatch):
    saving = saver(tmp_path)
    with monkeypatch.context() as patch:
        FaultyDisk(patch, at=1, way="fails on")
        saving.begin(state_at(2))
        settled(saving)
    saving.finish(state_at(2))
    assert names(tmp_path / "checkpoints") == [name_of(2)]


def test_a_slow_disk_costs_checkpoints_and_is_said_once(tmp_path, caplog):
    """The first save is held in the middle, as on a disk that takes its time."""
    held, go_on = threading.Event(), threading.Event()

    def facts(_state):
        held.set()
        assert go_on.wait(10)
        return {}

    saving = Saving(Disk(tmp_path, "logs"), tmp_path / "checkpoints", 2, facts)
    saving.begin(state_at(2))
    assert held.wait(10)
    for iteration in (4, 6):
        saving.begin(state_at(iteration))
    assert caplog.text.count("the disk is slow") == 1
    assert "the checkpoint of iteration 4 is left out" in caplog.text
    assert saving.unsaved(6) == 6
    go_on.set()
    saving.finish(state_at(7))
    assert names(tmp_path / "checkpoints") == [name_of(2), name_of(7)]


def test_a_disk_that_fails_is_not_called_slow(tmp_path, monkeypatch, caplog):
    held, go_on = threading.Event(), threading.Event()

    def pause(_seconds):
        held.set()
        assert go_on.wait(10)

    saving = saver(tmp_path, pause)
    FaultyDisk(monkeypatch, at=3, way="fails once")
    saving.begin(state_at(2))
    assert held.wait(10)
    saving.begin(state_at(4))
    go_on.set()
    saving.finish(state_at(4))
    assert "slow" not in caplog.text
    assert names(tmp_path / "checkpoints") == [name_of(2), name_of(4)]


def test_an_error_that_is_not_the_disks_is_not_swallowed(tmp_path):
    def broken(_state):
        raise KeyError("spaces")

    disk = Disk(tmp_path, "logs")
    saving = Saving(disk, tmp_path / "checkpoints", 2, broken)
    saving.begin(state_at(2))
    with pytest.raises(KeyError, match="spaces"):
        saving.finish(state_at(2))


def test_the_best_is_the_best_of_those_that_are_on_the_disk(tmp_path, monkeypatch):
    """Means 1, 5, 3, 4: the 5 could not be written, so 3 and then 4 are the best."""
    saving = saver(tmp_path)
    notes = []
    for iteration, mean in ((1, 1.0), (2, 5.0), (3, 3.0), (4, 4.0)):
        with monkeypatch.context() as patch:
            if mean == 5.0:
                FaultyDisk(patch, at=1, way="fails on")
            saving.begin(state_at(iteration, mean))
            settled(saving)
        notes.append(json.loads((tmp_path / "checkpoints" / "best.json").read_text()))
    assert [note["episode_return_mean"] for note in notes] == [1.0, 1.0, 3.0, 4.0]
    found = newest_checkpoint(tmp_path / "checkpoints")
    assert found is not None
    assert State.from_checkpoint(found).best_mean == 4.0


def test_a_resumed_run_keeps_its_best(tmp_path):
    first = saver(tmp_path)
    first.finish(state_at(1, 5.0))
    found = newest_checkpoint(tmp_path / "checkpoints")
    assert found is not None
    second = saver(tmp_path)
    second.resumed(State.from_checkpoint(found))
    assert second.unsaved(1) == 0
    second.finish(state_at(2, 3.0))
    note = json.loads((tmp_path / "checkpoints" / "best.json").read_text())
    assert note == {"name": name_of(1), "episode_return_mean": 5.0}


def test_a_best_that_was_saved_but_not_yet_marked_is_marked_by_the_next_start(
    tmp_path, monkeypatch
):
    first = saver(tmp_path)
    first.finish(state_at(1, 1.0))
    with monkeypatch.context() as killed:
        killed.setattr("learner.saving.mark_best", lambda *_: None)  # killed before it
        first.finish(state_at(2, 5.0))
    found = newest_checkpoint(tmp_path / "checkpoints")
    assert found is not None
    second = saver(tmp_path)
    second.resumed(State.from_checkpoint(found))
    for iteration, mean in ((3, 3.0), (4, 3.5), (5, 2.0)):
        second.finish(state_at(iteration, mean))
    note = json.loads((tmp_path / "checkpoints" / "best.json").read_text())
    assert note == {"name": name_of(2), "episode_return_mean": 5.0}
    assert (tmp_path / "checkpoints" / name_of(2)).exists()
