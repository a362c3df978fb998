"""It learns: a small task, from nothing to mastered, as a user would start it."""

import pytest

from tests.support import result

pytestmark = pytest.mark.slow
RUN = ("--env", "InvertedPendulum-v5", "--seed", "3", "--total-timesteps", "150000")


def test_the_inverted_pendulum_is_balanced_after_150000_steps(harness):
    run_dir = harness.folder / "run"
    learner = harness.learner(*RUN, run_dir=run_dir)
    assert learner.wait(deadline=600.0) == 0, learner.text
    outcome = result(run_dir)
    assert outcome["status"] == "finished"
    assert outcome["episode_return_mean"] >= 900  # of at most 1000: one per step that it stands
