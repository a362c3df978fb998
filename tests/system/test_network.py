"""Bad networks between the learner and its workers: the run finishes, with the same bits.

Two external workers and no local one. Where a link fails, the other worker is then stopped for
ever: so the run can only finish if the first one has come back.
"""

import re

import pytest

from dppo.chaos.cast import Setup
from dppo.chaos.drill import ByIteration, Drill
from dppo.chaos.plan import Fault, Plan
from tests.support import SMALL

pytestmark = pytest.mark.slow
FLAGS = ("--env", "Hopper-v5", *SMALL, "--hidden-sizes", "32", "32", "--verbose")
PATIENCE = 60.0
THE_WHOLE_RUN = 600.0


class Case:
    """Runs of so many iterations, with faults and without."""

    def __init__(self, folder, iterations):
        self.folder = folder
        self.flags = (*FLAGS, "--total-timesteps", str(iterations * 8 * 64))

    def drilled(self, name, faults, local_workers=0, workers=2):
        (self.folder / name).mkdir()
        setup = Setup(self.flags, local_workers, workers)
        return Drill(setup, ByIteration(Plan(faults), PATIENCE), self.folder / name).run()

    def costs_no_bits(self, *faults):
        """What the learner logged."""
        quiet = self.drilled("quiet", (), local_workers=2, workers=0)
        outcome = self.drilled("disturbed", faults)
        assert (quiet.problem, outcome.problem) == ("", "")
        assert outcome.left_behind == []
        assert [record.said for record in outcome.faults] == [""] * len(faults)
        assert outcome.sha256 == quiet.sha256
        return (self.folder / "disturbed" / "run" / "log.txt").read_text()


@pytest.mark.parametrize("kind", ["partition", "partition-to-learner", "partition-to-worker"])
def test_a_partitioned_worker_is_given_up_and_comes_back(tmp_path, kind):
    log = Case(tmp_path, 100).costs_no_bits(
        Fault(3, kind, "w0", 3.0), Fault(60, "stop-worker", "w1")
    )
    left = re.search(r"worker w0-\S+ left", log)
    assert left is not None
    assert re.search(r"worker w0-\S+ joined", log[left.end() :])


def test_a_worker_that_dies_behind_a_partition_is_given_up(tmp_path):
    """A half-open connection: nothing tells the learner that the other end is gone."""
    log = Case(tmp_path, 100).costs_no_bits(
        Fault(3, "partition", "w0", 4.0), Fault(3, "kill-worker", "w0")
    )
    assert re.search(r"worker w0-\S+ left: (its connection is gone|it was given up)", log)


def test_a_partition_of_all_workers_stops_the_run_and_no_longer_than_it_lasts(tmp_path):
    log = Case(tmp_path, 40).costs_no_bits(
        Fault(3, "partition", "w0", 4.0), Fault(3, "partition", "w1", 4.0)
    )
    assert "0 in the run" in log


def test_a_partition_shorter_than_the_lease_costs_time_only(tmp_path):
    log = Case(tmp_path, 40).costs_no_bits(Fault(3, "partition", "w0", 0.5))
    assert not re.search(r"worker w0-\S+ left", log)


@pytest.mark.parametrize("kind", ["loss", "slow", "delay"])
def test_a_bad_link_for_the_whole_run_costs_time_only(tmp_path, kind):
    Case(tmp_path, 6).costs_no_bits(
        *(Fault(1, kind, worker, THE_WHOLE_RUN) for worker in ("w0", "w1"))
    )


def test_a_slow_late_and_lossy_link_at_once_costs_time_only(tmp_path):
    Case(tmp_path, 6).costs_no_bits(
        *(Fault(1, kind, "w0", THE_WHOLE_RUN) for kind in ("loss", "slow", "delay"))
    )


def test_connections_that_break_again_and_again_are_made_again(tmp_path):
    breaks = [Fault(at, "disconnect", "w0") for at in range(3, 60, 20)]
    log = Case(tmp_path, 100).costs_no_bits(*breaks, Fault(80, "stop-worker", "w1"))
    assert len(re.findall(r"worker w0-\S+ joined", log)) >= 2


def test_a_learner_that_comes_back_on_the_far_side_of_a_partition_finds_its_workers(tmp_path):
    Case(tmp_path, 60).costs_no_bits(
        Fault(10, "partition", "w0", 3.0),
        Fault(10, "kill-learner", "learner"),
        Fault(40, "stop-worker", "w1"),
    )


@pytest.mark.parametrize("kind", ["corrupt-to-learner", "corrupt-to-worker"])
def test_bits_that_turn_over_on_the_way_never_reach_the_parameters(tmp_path, kind):
    log = Case(tmp_path, 60).costs_no_bits(
        Fault(3, kind, "w0", 3.0), Fault(40, "stop-worker", "w1", 10.0)
    )
    assert re.search(r"worker w0-\S+ left", log)
