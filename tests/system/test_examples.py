"""The examples, each as a person runs it: a process, and what it prints."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support import ROOT, printed

EXAMPLES = ROOT / "examples"


def test_the_chain_has_the_variance_of_its_closed_form():
    rows = re.findall(
        r"s_\d +([\d.]+) +([\d.]+) +([\d.]+)", printed(EXAMPLES / "variance_of_a_chain.py")
    )
    found = [tuple(map(float, row)) for row in rows]
    # γ = 0.9, stds 1, 2, 3: 9, then 4 + 0.81 x 9, then 1 + 0.81 x 11.29
    assert [exact for exact, _, _ in found] == pytest.approx([10.145, 11.29, 9.0], abs=5e-4)
    for exact, sigma, sampled in found:
        assert sigma == pytest.approx(exact, rel=0.03)
        assert sampled == pytest.approx(exact, rel=0.03)


@pytest.mark.slow
def test_four_rooms_shows_what_the_penalty_is_worth():
    text = printed(EXAMPLES / "four_rooms.py", "4")
    rows = re.findall(r"^psi (0|0\.25) +([\d.]+) +([\d.]+)$", text, re.MULTILINE)
    optimum = [(float(value), float(variance)) for _, value, variance in rows[:2]]
    assert optimum == [(45.85, 122.70), (44.72, 11.26)]
    (plain, plain_frozen), (safe, safe_frozen) = (
        (float(score), float(frozen)) for _, score, frozen in rows[2:]
    )
    assert safe > plain
    assert safe_frozen < plain_frozen / 3


@pytest.mark.slow
def test_one_process_prints_the_same_lines_for_any_number_of_workers():
    two, three = (printed(EXAMPLES / "one_process.py", number) for number in ("2", "3"))
    assert two == three
    assert re.search(r"parameters_sha256 [0-9a-f]{64}\n$", two)
    returns = [float(value) for value in re.findall(r"return ([\d.]+)", two)]
    assert len(returns) == 12  # 12,000 steps in iterations of 1024, rounded up
    assert returns[-1] > returns[0]


@pytest.mark.slow
def test_a_policy_is_loaded_from_the_run_directory_that_training_left(tmp_path: Path):
    folder = tmp_path / "run"
    settings = "--env InvertedPendulum-v5 --total-timesteps 2048 --num-steps 64 --update-epochs 1"
    printed("-m", "learner", *settings.split(), "--run-dir", folder)

    text = printed(EXAMPLES / "load_a_policy.py", folder)

    assert re.search(r"^iteration-\d{8} of .*: trained for (1024|2048) steps$", text, re.MULTILINE)
    assert re.search(r"^expected: discounted return -?[\d.]+ ± [\d.]+$", text, re.MULTILINE)
    played = re.search(r"one episode: (\d+) steps, return ([\d.]+)", text)
    assert played is not None
    (newest, *_) = sorted((folder / "checkpoints").glob("iteration-*"), reverse=True)
    assert f"{newest.name} of {newest}: " in printed(EXAMPLES / "load_a_policy.py", newest)
    (newest / "manifest.json").write_text("{}")
    refused = subprocess.run(
        [sys.executable, EXAMPLES / "load_a_policy.py", newest],
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert refused.returncode == 1
    assert refused.stderr.startswith("error: ")
    assert len(refused.stderr.splitlines()) == 1
    fallen = int(played[1]) - float(played[2])  # 1 a step, 0 for the one it falls in
    assert fallen in {0.0, 1.0}
