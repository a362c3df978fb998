"""Workers that compute otherwise are told from the others."""

import logging
from pathlib import Path

import pytest

from dppo.wire.messages import Hello, Ready
from learner.facts import check_environment
from learner.roster import Roster

OURS = "code 3f2a9c, numpy 2.4.6, mujoco 4.0.0"


def hello(name, numerics="9c1e", versions=OURS):
    return Hello(worker=name, host="lab1", pid=7, numerics=numerics, versions=versions)


def ready(name):
    return Ready(
        worker=name, generation=1, obs_size=3, action_kind="box", action_sizes=(2,),
        env_hash="", exact="captured",
    )  # fmt: skip


@pytest.mark.parametrize(
    ("other", "said"),
    [
        (hello("w2"), ""),
        (hello("w2", versions="code 111111, numpy 2.4.6, mujoco 4.0.0"), "has other code"),
        (hello("w2", versions="mujoco 4.0.0"), "has other code"),  # of an earlier version
        (hello("w2", numerics="77aa"), "computes with (77aa, code 3f2a9c"),
    ],
)
def test_a_run_is_exact_as_long_as_all_its_workers_compute_alike(other, said, caplog):
    roster = Roster(code="3f2a9c")
    with caplog.at_level(logging.WARNING):
        for one in (hello("w1"), other):
            roster.greet(one)
    assert said in caplog.text
    assert roster.admit(ready("w1")) == ""
    assert roster.exact  # the other one computes nothing yet
    assert roster.admit(ready("w2")) == ""
    assert roster.exact == (not said)
    assert bool(caplog.records) == bool(said)


def test_even_the_first_worker_may_have_other_code():
    roster = Roster(code="3f2a9c")
    roster.greet(hello("w1", versions="code 111111, numpy 2.4.6"))
    roster.admit(ready("w1"))
    assert not roster.exact


@pytest.mark.parametrize("name", ["", "code", "versions", "numerics"])
def test_a_run_that_goes_on_with_other_software_is_told_and_not_exact(name, caplog):
    before = {"code": "a", "versions": {"numpy": "2"}, "numerics": "9c1e", "environment": {"x": 1}}
    now = before | ({name: "b"} if name else {})
    with caplog.at_level(logging.WARNING):
        assert check_environment(before, now, Path("run")) == (not name)
    assert [record.message.partition(":")[0] for record in caplog.records] == [name] * bool(name)
