"""Runs made with different code can be told apart."""

import re

import pytest

from dppo.sources import code_hash
from tests.support import printed


def test_the_hash_is_of_names_and_contents_of_our_files_and_of_nothing_else(tmp_path):
    for name in ("dppo", "learner", "workers/deep"):
        (tmp_path / name).mkdir(parents=True)
        (tmp_path / name / "a.py").write_text("a = 1\n")
    first = code_hash(tmp_path)
    assert len(first) == 12
    (tmp_path / "dppo" / "notes.txt").write_text("no code")
    (tmp_path / "mine.py").write_text("not ours")
    assert code_hash(tmp_path) == first
    (tmp_path / "workers" / "deep" / "a.py").write_text("a = 2\n")
    second = code_hash(tmp_path)
    (tmp_path / "learner" / "a.py").rename(tmp_path / "learner" / "b.py")
    assert len({first, second, code_hash(tmp_path)}) == 3
    assert code_hash() != code_hash(tmp_path)


@pytest.mark.parametrize("command", ["dppo", "learner", "workers", "dppo eval"])
def test_every_command_says_which_code_and_libraries_it_is(command):
    line = printed("-m", *command.split(), "--version")
    numbers = r"numpy \S+, mujoco \S+, gymnasium \S+, eclipse-zenoh \S+"
    assert re.fullmatch(rf"dppo \S+ \(code {code_hash()}, {numbers}\)\n", line)
