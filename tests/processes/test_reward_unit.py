"""The unit of rewards changes nothing but what is told in it."""

import json

import pytest

from dppo.store.checkpoint import newest_checkpoint
from tests.support import SMALL, Harness

pytestmark = pytest.mark.slow
POWERS = (0, -10, 10)
"""Rewards times 2 to these: whole numbers of bits, so every division is exact."""


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """The rows of metrics.jsonl and the final parameters, by factor."""
    harness, found = Harness(tmp_path_factory.mktemp("units")), {}
    for power in POWERS:
        weights = {"forward_reward_weight": 2.0**power, "ctrl_cost_weight": 0.125 * 2.0**power}
        run_dir = harness.folder / f"run{power}"
        harness.train(
            "--env", "HalfCheetah-v4", *SMALL, "--total-timesteps", str(20 * 8 * 64),
            "--env-kwargs", json.dumps(weights), "--local-workers", "1", run_dir=run_dir,
        )  # fmt: skip
        checkpoint = newest_checkpoint(run_dir / "checkpoints")
        assert checkpoint is not None
        rows = [json.loads(line) for line in (run_dir / "metrics.jsonl").read_text().splitlines()]
        found[power] = rows, checkpoint.arrays["parameters"]
    return found


@pytest.mark.parametrize("power", POWERS[1:])
def test_it_learns_the_same_whatever_the_rewards_unit_is(runs, power):
    rows, parameters = runs[power]
    plain, expected = runs[0]
    assert parameters == pytest.approx(expected, rel=1e-3, abs=1e-4)
    for row, other in zip(rows[1:], plain[1:], strict=True):  # the first one has no scale
        for name, unit in (("safety/sigma_mean", 4.0**power), ("train/variance_loss", 1.0)):
            assert row[name] == pytest.approx(unit * other[name], rel=1e-2), (
                row["iteration"],
                name,
            )
