"""A run's folder belongs to one learner at a time, and to one run."""

import json
import os
import re
import shutil
import subprocess
import sys
from dataclasses import replace

import pytest

from dppo.config import Config, RunConfig, SafetyConfig
from dppo.errors import SupersededError, UsageError
from dppo.presets import paper
from dppo.store.checkpoint import Checkpoint, name_of, save_checkpoint
from dppo.store.run_directory import RunDirectory, default_path, read_config

HOLDER = """
import sys
from pathlib import Path
from dppo.store.run_directory import RunDirectory
RunDirectory.open(Path(sys.argv[1]))
print("locked", flush=True)
sys.stdin.read()
"""


def test_a_folder_in_use_is_refused_until_its_process_is_gone(tmp_path):
    command = [sys.executable, "-c", HOLDER, str(tmp_path)]
    with subprocess.Popen(command, stdin=-1, stdout=-1, text=True) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "locked\n"
        sentence = f"another learner is at work in --run-dir {tmp_path}; stop it, or give another"
        with pytest.raises(UsageError, match=re.escape(sentence)):
            RunDirectory.open(tmp_path)
        other.kill()
    assert RunDirectory.open(tmp_path).path == tmp_path


def test_a_refusal_does_not_free_the_folder(tmp_path):
    first = RunDirectory.open(tmp_path)
    for _ in range(2):
        with pytest.raises(UsageError, match="another learner is at work"):
            RunDirectory.open(first.path)


def test_the_folder_and_its_parents_are_made(tmp_path):
    folder = RunDirectory.open(tmp_path / "deep" / "run")
    assert folder.is_new
    assert folder.checkpoints.is_dir()
    assert not folder.has_run


@pytest.mark.parametrize("below", ["file/run", "file"])
def test_a_folder_that_cannot_be_made_is_refused(tmp_path, below):
    (tmp_path / "file").write_text("not a folder")
    sentence = f"--run-dir {tmp_path / below} cannot be written: "
    with pytest.raises(UsageError, match=re.escape(sentence) + ".*; give a folder of yours"):
        RunDirectory.open(tmp_path / below)


def test_a_checkpoint_makes_it_the_folder_of_a_run(tmp_path):
    folder = RunDirectory.open(tmp_path)
    save_checkpoint(folder.checkpoints, name_of(0), Checkpoint({}, {}))
    assert folder.has_run
    assert not folder.is_new


def test_a_new_folder_of_a_run_that_never_began_is_removed(tmp_path):
    folder = RunDirectory.open(tmp_path / "run")
    folder.next_generation()
    folder.discard_unused()
    assert not folder.path.exists()


def test_a_folder_that_was_there_or_holds_a_run_stays(tmp_path):
    before = RunDirectory.open(tmp_path)
    before.discard_unused()
    assert before.path.exists()
    begun = RunDirectory.open(tmp_path / "run")
    begun.write("config.json", "{}")
    begun.discard_unused()
    assert begun.path.exists()


def test_every_start_has_the_next_generation(tmp_path):
    folder = RunDirectory.open(tmp_path)
    assert [folder.next_generation() for _ in range(3)] == [1, 2, 3]
    os.close(folder._lock)  # as if the process had ended
    assert RunDirectory.open(tmp_path).next_generation() == 4


@pytest.mark.parametrize("text", ["", "x", "1.5"])
def test_an_unreadable_generation_starts_again_at_one(tmp_path, text):
    folder = RunDirectory.open(tmp_path)
    (tmp_path / "generation").write_text(text)
    assert [folder.next_generation() for _ in range(2)] == [1, 2]


def test_a_damaged_generation_counts_on_from_the_checkpoints(tmp_path):
    """Generations 2 and 5 saved something, the checkpoint of 5 was found corrupt since."""
    folder = RunDirectory.open(tmp_path)
    for name, generation in (("iteration-00000010", 2), ("corrupt-iteration-00000020", 5)):
        facts = {"run": folder.run_id(), "generation": generation}
        save_checkpoint(folder.checkpoints, name, Checkpoint({}, facts))
    (tmp_path / "generation").write_text("")
    assert [folder.next_generation() for _ in range(2)] == [6, 7]


def test_an_older_checkpoint_brought_back_does_not_bring_back_its_generation(tmp_path):
    folder = RunDirectory.open(tmp_path)
    save_checkpoint(
        folder.checkpoints, name_of(10), Checkpoint({}, {"run": "0" * 16, "generation": 1})
    )
    folder.write("generation", "4")
    assert folder.next_generation() == 5


@pytest.mark.parametrize("manifest", ["", "[]", "{}", '{"facts": {"run": "x"}}', '{"facts": 3}'])
def test_a_checkpoint_that_does_not_say_its_generation_is_passed_over(tmp_path, manifest):
    folder = RunDirectory.open(tmp_path)
    (folder.checkpoints / name_of(3)).mkdir()
    (folder.checkpoints / name_of(3) / "manifest.json").write_text(manifest)
    assert folder.next_generation() == 1


def test_the_run_id_is_made_once_and_kept_by_every_copy(tmp_path):
    folder = RunDirectory.open(tmp_path / "a")
    made = folder.run_id()
    assert re.fullmatch("[0-9a-f]{16}", made)
    assert folder.run_id() == made
    shutil.copytree(tmp_path / "a", tmp_path / "b")
    assert RunDirectory.open(tmp_path / "b").run_id() == made
    assert RunDirectory.open(tmp_path / "c").run_id() != made


@pytest.mark.parametrize("text", ["", "x", "0" * 17, "\udcff"])
def test_a_damaged_run_id_is_taken_from_the_checkpoints(tmp_path, text):
    folder = RunDirectory.open(tmp_path)
    made = folder.run_id()
    facts = {"run": made, "generation": 1}
    save_checkpoint(folder.checkpoints, name_of(0), Checkpoint({}, facts))
    (tmp_path / "run-id").write_bytes(text.encode(errors="surrogateescape"))
    assert folder.run_id() == made
    assert (tmp_path / "run-id").read_text() == made


def test_a_learner_after_which_another_was_started_here_may_not_write(tmp_path):
    folder = RunDirectory.open(tmp_path)
    mine = folder.next_generation()
    folder.check_generation(mine)
    folder.next_generation()
    with pytest.raises(SupersededError, match=r"generation 2, was started in .* after this one"):
        folder.check_generation(mine)


def test_an_old_copy_stays_fenced_off_until_somebody_deletes_the_note(tmp_path):
    folder = RunDirectory.open(tmp_path)
    folder.next_generation()
    folder.check_fence()
    told = folder.fence_off(SupersededError("worker w1 has served generation 7", newest=7))
    note = tmp_path / "superseded"
    assert str(told) == (
        "worker w1 has served generation 7; or, to go on from this one all the same, delete "
        f"{note}"
    )
    with pytest.raises(SupersededError, match="an earlier start here found: worker w1 has served"):
        folder.check_fence()
    note.unlink()
    folder.check_fence()
    assert folder.next_generation() == 8  # above what the workers have served


def test_a_disk_without_room_for_the_note_does_not_hide_the_reason(tmp_path, monkeypatch):
    def full(_handle):
        raise OSError(28, "No space left on device")

    folder = RunDirectory.open(tmp_path)
    reason = SupersededError("worker w1 has served generation 7", newest=7)
    monkeypatch.setattr(os, "fsync", full)
    assert folder.fence_off(reason) is reason


def test_a_folder_in_which_the_newer_learner_works_is_not_fenced_off(tmp_path):
    folder = RunDirectory.open(tmp_path)
    folder.write("generation", "7")
    reason = SupersededError("worker w1 has served generation 7", newest=7)
    assert folder.fence_off(reason) is reason
    folder.check_fence()


def test_a_small_file_is_replaced_all_or_nothing(tmp_path, monkeypatch):
    def full(_handle):
        raise OSError(28, "No space left on device")

    folder = RunDirectory.open(tmp_path)
    folder.write_json("result.json", {"status": "stopped"})
    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space left"):
        folder.write_json("result.json", {"status": "finished"})
    assert json.loads((tmp_path / "result.json").read_text()) == {"status": "stopped"}


def begun(tmp_path, config):
    folder = RunDirectory.open(tmp_path)
    folder.write_json("config.json", {"config": config.to_dict(), "versions": {"dppo": "0.1.0"}})
    return folder


def test_the_same_settings_continue_a_run(tmp_path):
    config = paper("Hopper-v4")
    begun(tmp_path, config).check_config(config)


def test_a_new_folder_takes_any_settings(tmp_path):
    RunDirectory.open(tmp_path).check_config(Config())


def test_every_other_setting_is_listed_by_its_flag(tmp_path):
    config = Config()
    folder = begun(tmp_path, config)
    other = replace(
        config,
        run=replace(config.run, seed=3),
        update=replace(config.update, max_grad_norm=float("inf")),
        network=replace(config.network, hidden_sizes=(32,)),
    )
    with pytest.raises(UsageError) as refusal:
        folder.check_config(other)
    assert str(refusal.value) == (
        f"{tmp_path} holds a run with other settings: --seed was 0, is 3; --max-grad-norm was 0.5,"
        " is inf; --hidden-sizes was [64, 64], is [32]; use the same settings to continue it, or "
        "another --run-dir"
    )


def test_a_config_that_cannot_be_read_stops_the_continuation(tmp_path):
    folder = RunDirectory.open(tmp_path)
    folder.write("config.json", "{")
    with pytest.raises(UsageError, match=r"config\.json is not a readable config file"):
        folder.check_config(Config())


def test_settings_come_from_json_or_toml_or_a_run(tmp_path):
    wanted = Config(run=RunConfig(seed=3), safety=SafetyConfig(psi=0.5))
    texts = {
        "a.json": '{"run": {"seed": 3}, "safety": {"psi": 0.5}}',
        "b.toml": "[run]\nseed = 3\n[safety]\npsi = 0.5\n",
        "config.json": json.dumps({"config": wanted.to_dict(), "versions": {}}),
    }
    for name, text in texts.items():
        (tmp_path / name).write_text(text)
        assert read_config(tmp_path / name) == wanted


UNREADABLE = [
    ("c.json", b"{", "is not a readable config file (JSON or TOML): "),
    ("c.toml", b"seed = ", "is not a readable config file (JSON or TOML): "),
    ("c.json", b"\xff\xfe", "is not a readable config file (JSON or TOML): "),
    ("c.json", b"[]", "is not a config file: found a list, expected tables such as [run]"),
    ("c.json", b"3", "is not a config file: found a int, expected tables such as [run]"),
    ("c.json", b'{"rum": {}}', "is not a config file: found the group 'rum', expected tables"),
    ("c.toml", b"[run]\nsed = 3\n", "is not a config file: found the setting 'sed', expected"),
    ("c.toml", b"[run]\nseed = 'x'\n", "is not a config file: seed is 'x', expected a"),
    ("c.toml", b"[returns]\ngamma = 1.5\n", "is not a config file: --gamma is 1.5, expected 0 .."),
    ("c.toml", b"[run]\nseed = inf\n", "is not a config file: seed is inf, expected a"),
    ("c.json", b'{"config": 3}', "is not a config file: "),
    ("c.json", b'{"config": []}', "is not a config file: "),
]


@pytest.mark.parametrize(("name", "data", "sentence"), UNREADABLE)
def test_what_is_no_config_file_is_refused_with_a_sentence(tmp_path, name, data, sentence):
    (tmp_path / name).write_bytes(data)
    with pytest.raises(UsageError, match=re.escape(f"{tmp_path / name} {sentence}")):
        read_config(tmp_path / name)


def test_a_missing_config_file_is_named(tmp_path):
    with pytest.raises(UsageError, match=re.escape(f"{tmp_path / 'none.toml'} is not a readable")):
        read_config(tmp_path / "none.toml")


def test_the_default_folder_says_what_runs_in_it():
    config = Config(run=RunConfig(env="mine:Ant/Big-v4", seed=7), safety=SafetyConfig(psi=0.5))
    path = str(default_path(config, "try"))
    assert re.fullmatch(r"runs/mine-Ant-Big-v4__try__psi0\.5__s7__\d{8}T\d{9}", path)
