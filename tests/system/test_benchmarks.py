"""Every benchmark, as a person runs it, as small as it goes: it prints JSON lines and a table."""

import json
from typing import Any

import pytest

from tests.support import printed


def lines(module: str, *words: str) -> list[dict[str, Any]]:
    """The JSON lines that a benchmark prints; it has to succeed."""
    text = printed("-m", f"benchmarks.{module}", *words).splitlines()
    found = [json.loads(line) for line in text if line.startswith("{")]
    assert found
    assert {line["benchmark"] for line in found} == {module}
    assert not text[-1].startswith("{")  # the table comes last
    return found


@pytest.mark.slow
def test_stepping_goes_through_the_same_states():
    words = ("--env", "Hopper-v5", "--actions", "random", "--seconds", "0.5", "--repeats", "1")
    (line,) = lines("stepping", *words)
    assert {"raw", "gymnasium"} <= line["steps_per_second"].keys()
    assert min(line["steps_per_second"].values()) > 0
    assert line["resets"] > 0
    assert all(line["same_states"].values())


@pytest.mark.slow
def test_end_to_end_says_who_is_not_installed():
    words = ("--env", "InvertedPendulum-v5", "--seconds", "0.1", "--repeats", "1")
    trainers = ("--trainers", "dppo", "dppo-full", "sb3")
    found = lines("end_to_end", *words, *trainers, "--python", "/nowhere/python")
    by_name = {line["trainer"]: line for line in found}
    assert by_name["dppo"]["ratio"] > 0
    assert by_name["dppo-full"]["ratio"] > 0
    assert "/nowhere/python" in by_name["sb3"]["skipped"]


@pytest.mark.slow
def test_cleanrl_settings_train():
    words = ("--env", "Hopper-v4", "--trainers", "cleanrl-equal", "--seconds", "0.1")
    (line,) = lines("end_to_end", *words, "--repeats", "1")
    assert line["steps_per_second"] > 0


@pytest.mark.slow
def test_an_iteration_is_split_into_its_parts():
    words = ("--env", "Hopper-v5", "--iterations", "1", "--workers", "1", "--slots", "2")
    learner, worker = lines("iteration", *words)
    assert learner["absent"] == worker["absent"] == []
    parts = {"physics", "observations", "rewards", "stepping", "resets", "inference", "noise"}
    parts |= {"recording", "snapshots", "advantages", "gradients", "final KL"}
    both = {"codec", "exchange", "idle"}
    assert all(worker["ms"][part] > 0 for part in parts | both)
    own = {"rounds", "children", "sums", "Adam"}
    assert all(learner["ms"][part] > 0 for part in own | both)


@pytest.mark.slow
def test_the_exchange_is_measured_over_all_transports():
    (line,) = lines("exchange", "--workers", "2", "--rounds", "3", "--repeats", "1")
    present = {"pairs", "zenoh", "shared", "gloo"}
    assert line["ms"].keys() | line["skipped"].keys() == present | {"zmq"}
    assert present <= line["ms"].keys()
    assert min(line["ms"].values()) > 0


@pytest.mark.slow
def test_scaling_counts_processes_and_puppets():
    words = ("--env", "Hopper-v5", "--workers", "1", "--seconds", "0.1", "--repeats", "1")
    run, one, many = lines("scaling", *words, "--slots", "1", "16", "--iterations", "1")
    assert run["steps_per_second"] > 0
    assert many["ms_per_update"] > one["ms_per_update"] > 0


@pytest.mark.slow
def test_memory_has_a_line_per_process():
    words = ("--env", "Hopper-v5", "--minutes", "0.1", "--interval", "0.2")
    found = lines("memory", *words)
    assert "learner" in {line["process"] for line in found}
    assert min(line["largest_mb"] for line in found) > 10


@pytest.mark.slow
def test_start_is_in_order():
    help_line, started = lines("start", "--env", "Hopper-v5", "--repeats", "1")
    assert help_line["seconds"] > 0
    assert 0 < started["asked"] < started["collected"] <= started["progress"]
