"""`dppo bench`: what it measures, and what it makes of it."""

import json
from typing import Any

import pytest

from workers.bench import Bench, _quota


def found(**changes) -> Bench:
    """A quiet machine of two cores, on which 16 environments step no faster than 2."""
    values: dict[str, Any] = {
        "env": "Ant-v4", "cores": 2, "quota": 2.0, "load": 0.1, "raw": 5000.0,
        "one_process": {1: 5900.0, 2: 6100.0, 16: 6200.0}, "all_cores": 12000.0, "threads": {},
    }  # fmt: skip
    return Bench(**(values | changes))


def test_a_quiet_machine_needs_no_advice_but_the_default():
    assert list(found().advice()) == [
        "--local-workers 2 is the default here: one per core, at most --slots"
    ]


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"quota": 1.5}, "may use 1.5 cores' worth of time: start --local-workers 2"),
        ({"load": 1.7}, "1.7 processes wanted a core before this began"),
        ({"all_cores": 6200.0 * 1.4}, "2 processes step only 1.4 times as much as one"),
        ({"cores": 12, "quota": 12.0}, "--slots 8 leaves 4 cores idle"),
        (
            {"one_process": {2: 80.0, 16: 100.0, 32: 125.0}},
            "2 workers step 16 environments each, 32 would step 1.25 times as fast: "
            "--num-envs 8 --num-steps 32",
        ),
        ({"threads": {"OMP_NUM_THREADS": "8"}}, "OMP_NUM_THREADS=8 does not matter"),
    ],
)
def test_what_costs_speed_is_said_in_a_sentence(changes, sentence):
    assert sentence in "\n".join(found(**changes).advice())


def test_a_container_quota_is_read_as_cores(tmp_path):
    file = tmp_path / "cpu.max"
    file.write_text("150000 100000\n")
    assert _quota(file, 8) == 1.5
    file.write_text("max 100000\n")
    assert _quota(file, 8) == _quota(tmp_path / "nothing", 8) == 8.0


@pytest.mark.slow
def test_the_command_measures_raw_and_ours(harness):
    process = harness.start("dppo", "bench", "--env", "Hopper-v5", "--seconds", "0.05", "--json")
    assert process.wait() == 0, process.text
    printed = json.loads(process.text)
    assert printed["env"] == "Hopper-v5"
    assert min(printed["raw"], printed["all_cores"], *printed["one_process"].values()) > 0
    assert set(printed["one_process"]) == {"1", "2", "4", "8", "16", "32"}


@pytest.mark.slow
def test_an_environment_without_mujoco_has_no_raw_line(harness):
    process = harness.start("dppo", "bench", "--env", "CartPole-v1", "--seconds", "0.05")
    assert process.wait() == 0, process.text
    assert process.text.startswith("CartPole-v1 on ")
    assert "raw" not in process.text


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--env", "Ant-v44"], "--env is 'Ant-v44', which Gymnasium does not know; did you mean"),
        (["--seconds", "0"], "--seconds is 0.0, expected 0 < seconds <= 60"),
    ],
)
def test_wrong_usage_is_one_sentence_and_code_2(harness, words, sentence):
    process = harness.start("dppo", "bench", *words)
    assert process.wait() == 2
    assert sentence in " ".join(process.text.replace("│", " ").split())
    assert "Traceback" not in process.text
