"""What a checkpoint says to those who want to go on from it, or only to look."""

import numpy as np
import pytest

from dppo.errors import UsageError
from dppo.store.checkpoint import Checkpoint, load_checkpoint, name_of, save_checkpoint
from dppo.store.contents import SNAPSHOT_FORM, check_snapshots, mean_reward


def test_snapshots_of_another_version_are_refused_but_the_checkpoint_can_be_read(tmp_path):
    save_checkpoint(tmp_path, name_of(3), Checkpoint({}, {"snapshots": SNAPSHOT_FORM}))
    check_snapshots(load_checkpoint(tmp_path / name_of(3)))
    save_checkpoint(tmp_path, name_of(4), Checkpoint({}, {}))  # before the form had a number
    old = load_checkpoint(tmp_path / name_of(4))
    sentence = f"saved in form 1, this version restores form {SNAPSHOT_FORM}; finish the run with"
    with pytest.raises(UsageError, match=sentence):
        check_snapshots(old)


def test_the_mean_reward_of_a_step_weighs_episodes_by_their_length():
    assert mean_reward(np.array([[30.0, 10], [10.0, 40]])) == 0.8
    assert mean_reward(np.empty((0, 2))) == 0.0
