"""A checkpoint is whole or it is none; whatever stops the writing, there is one to go on from."""

import json
import logging

import numpy as np
import pytest

from dppo.errors import CheckpointError
from dppo.store import checkpoint as store
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
    sha256,
)


def numbered(iteration):
    arrays = {"parameters": np.arange(6, dtype=np.float32) + iteration, "count": np.array([7])}
    return Checkpoint(arrays, {"state": {"iteration": iteration, "best": None}, "name": "ψ"})


def save(folder, iteration):
    return save_checkpoint(folder, name_of(iteration), numbered(iteration))


def newest_iteration(folder):
    found = newest_checkpoint(folder)
    return None if found is None else found.facts["state"]["iteration"]


def test_arrays_and_facts_come_back(tmp_path):
    arrays = {
        "single": np.array([1.5, -0.0, np.nan, np.inf], np.float32),
        "double": np.array([[5e-324, 1 / 3]]),
        "bytes": np.frombuffer(b"\x00\xff", np.uint8),
        "empty": np.empty((0, 2)),
        "slot/12": np.array([2**62]),
    }
    facts = {"a": [1, 2.5, None, True], "text": "ψ", "nested": {"x": {}}}
    folder = save_checkpoint(tmp_path, name_of(3), Checkpoint(arrays, facts))
    loaded = load_checkpoint(str(folder))
    assert load_checkpoint(folder).facts == facts
    assert loaded.facts == facts
    assert set(loaded.arrays) == set(arrays)
    for name, array in arrays.items():
        assert loaded.arrays[name].dtype == array.dtype
        assert loaded.arrays[name].shape == array.shape
        assert loaded.arrays[name].tobytes() == array.tobytes()


@pytest.mark.parametrize(
    "view", [lambda a: a.T, lambda a: a[:, ::2], lambda a: a[::-1]], ids=["T", "step 2", "step -1"]
)
def test_views_are_saved_as_what_they_show(tmp_path, view):
    shown = view(np.arange(12.0).reshape(3, 4))
    path = save_checkpoint(tmp_path, name_of(0), Checkpoint({"a": shown}, {}))
    assert np.array_equal(load_checkpoint(path).arrays["a"], shown)
    assert sha256(shown) == sha256(shown.copy())


def test_names_sort_by_iteration(tmp_path):
    for iteration in (100, 9, 20):
        save(tmp_path, iteration)
    assert names(tmp_path) == [name_of(9), name_of(20), name_of(100)]
    assert newest_iteration(tmp_path) == 100


def test_no_flipped_bit_goes_unnoticed(tmp_path):
    path = save(tmp_path, 4)
    for file in (path / "manifest.json", path / "arrays.safetensors"):
        whole = file.read_bytes()
        for at in range(len(whole)):
            torn = bytearray(whole)
            torn[at] ^= 1 << (at % 8)
            file.write_bytes(torn)
            with pytest.raises(CheckpointError, match=r"cannot be read|does not match its"):
                load_checkpoint(path)
        file.write_bytes(whole)
    load_checkpoint(path)


def test_the_sentence_names_the_altered_file(tmp_path):
    path = save(tmp_path, 4)
    arrays = path / "arrays.safetensors"
    arrays.write_bytes(arrays.read_bytes()[:-1] + b"\x77")
    with pytest.raises(CheckpointError, match=f"{arrays} does not match its checksum"):
        load_checkpoint(path)
    manifest = path / "manifest.json"
    values = json.loads(manifest.read_bytes())
    values["facts"]["state"]["iteration"] = 5
    manifest.write_text(json.dumps(values))
    with pytest.raises(CheckpointError, match=f"{manifest} does not match its own checksum"):
        load_checkpoint(path)


def test_no_truncated_file_goes_unnoticed(tmp_path):
    path = save(tmp_path, 4)
    for file in (path / "manifest.json", path / "arrays.safetensors"):
        whole = file.read_bytes()
        for length in range(0, len(whole), 7):
            file.write_bytes(whole[:length])
            with pytest.raises(CheckpointError, match=r"cannot be read|does not match its"):
                load_checkpoint(path)
        file.write_bytes(whole)


@pytest.mark.parametrize("missing", ["manifest.json", "arrays.safetensors"])
def test_a_missing_file_is_named(tmp_path, missing):
    path = save(tmp_path, 4)
    (path / missing).unlink()
    with pytest.raises(CheckpointError, match=f"cannot be read: .*{missing}"):
        load_checkpoint(path)


@pytest.mark.parametrize("text", ["[]", "3", "null", "{}", '{"sha256": 3}', "not json", "\udcff"])
def test_a_manifest_that_is_something_else_is_refused(tmp_path, text):
    path = save(tmp_path, 4)
    (path / "manifest.json").write_text(text, errors="surrogateescape")
    with pytest.raises(CheckpointError, match=r"cannot be read|does not match its own checksum"):
        load_checkpoint(path)


def test_another_format_is_refused_with_both_numbers(tmp_path, monkeypatch):
    monkeypatch.setattr(store, "FORMAT", 2)
    path = save(tmp_path, 4)
    monkeypatch.undo()
    with pytest.raises(CheckpointError, match=f"{path} has format 2, this version reads 1"):
        load_checkpoint(path)


def spoil(folder, iteration):
    (folder / name_of(iteration) / "arrays.safetensors").write_bytes(b"torn")


def test_the_newest_whole_checkpoint_is_taken_and_the_torn_one_reported(tmp_path, caplog):
    for iteration in (1, 2, 3):
        save(tmp_path, iteration)
    spoil(tmp_path, 3)
    with caplog.at_level(logging.WARNING, "checkpoint"):
        assert newest_iteration(tmp_path) == 2
    assert f"{name_of(3)}/arrays.safetensors does not match its checksum; falling" in caplog.text


def test_nothing_but_torn_checkpoints_is_an_error(tmp_path):
    for iteration in (1, 2):
        save(tmp_path, iteration)
        spoil(tmp_path, iteration)
    sentence = f"every checkpoint in {tmp_path} is corrupt .{name_of(1)}, {name_of(2)}.; restore"
    with pytest.raises(CheckpointError, match=sentence):
        newest_checkpoint(tmp_path)


def test_no_checkpoint_is_none(tmp_path):
    assert newest_checkpoint(tmp_path) is None
    assert newest_checkpoint(tmp_path / "absent") is None


def test_a_torn_checkpoint_of_the_same_name_is_replaced(tmp_path):
    save(tmp_path, 4)
    spoil(tmp_path, 4)
    save(tmp_path, 4)
    assert newest_iteration(tmp_path) == 4


def test_pruning_keeps_the_newest_and_the_best(tmp_path):
    for iteration in range(1, 7):
        save(tmp_path, iteration)
    mark_best(tmp_path, name_of(2), 10.0)
    prune(tmp_path, 2)
    assert names(tmp_path) == [name_of(2), name_of(5), name_of(6)]
    assert best_name(tmp_path) == name_of(2)


@pytest.mark.parametrize(("keep", "left"), [(0, [2]), (1, [2]), (5, [1, 2])])
def test_pruning_always_keeps_one_and_never_more_than_there_are(tmp_path, keep, left):
    for iteration in (1, 2):
        save(tmp_path, iteration)
    prune(tmp_path, keep)
    assert names(tmp_path) == [name_of(iteration) for iteration in left]


@pytest.mark.parametrize("text", [None, "", "[]", "{}", '{"name": 3}', '{"name": "iteration-9"}'])
def test_there_is_no_best_without_a_note_of_one_that_exists(tmp_path, text):
    save(tmp_path, 1)
    if text is not None:
        (tmp_path / "best.json").write_text(text)
    assert best_name(tmp_path) is None
