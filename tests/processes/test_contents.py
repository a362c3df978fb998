"""What a checkpoint says to those who want to go on from it, or only to look."""

import re

import numpy as np
import pytest

from dppo.config import Config
from dppo.errors import UsageError
from dppo.store.checkpoint import Checkpoint, load_checkpoint, name_of, save_checkpoint
from dppo.store.contents import SNAPSHOT_FORM, check_snapshots, chosen, config_in, mean_reward


def test_snapshots_of_another_version_are_refused_but_the_checkpoint_can_be_read(tmp_path):
    save_checkpoint(tmp_path, name_of(3), Checkpoint({}, {"snapshots": SNAPSHOT_FORM}))
    check_snapshots(load_checkpoint(tmp_path / name_of(3)))
    save_checkpoint(tmp_path, name_of(4), Checkpoint({}, {}))  # before the form had a number
    old = load_checkpoint(tmp_path / name_of(4))
    sentence = f"saved in form 1, this version restores form {SNAPSHOT_FORM}; finish the run with"
    with pytest.raises(UsageError, match=sentence):
        check_snapshots(old)


def test_the_mean_reward_is_the_checkpoints_or_of_earlier_versions_that_of_its_episodes():
    episodes = np.array([[30.0, 10], [10.0, 40]])
    known = Checkpoint({"episodes": episodes}, {"state": {"mean_reward": 0.0}})
    assert mean_reward(known) == 0.0
    assert mean_reward(Checkpoint({"episodes": episodes}, {"state": {}})) == 0.8
    assert mean_reward(Checkpoint({"episodes": episodes[:0]}, {"state": {}})) == 0.0


@pytest.mark.parametrize(
    ("made_by", "writer"),
    [
        ({"dppo": "9.1.0", "code": "0123456789ab"}, "dppo 9.1.0 (code 0123456789ab)"),
        (None, "another version"),  # before checkpoints said who made them
    ],
)
def test_a_setting_of_another_version_is_named_with_that_version(tmp_path, made_by, writer):
    settings = Config().to_dict()
    facts = {"config": settings} | ({"made_by": made_by} if made_by else {})
    save_checkpoint(tmp_path / "checkpoints", name_of(3), Checkpoint({}, facts))
    assert config_in(chosen(str(tmp_path), "newest")[1]) == Config()
    settings["safety"]["phi"] = 0.1
    save_checkpoint(tmp_path / "checkpoints", name_of(4), Checkpoint({}, facts))
    sentence = f"the checkpoint was written by {writer}, this is dppo "
    with pytest.raises(UsageError, match=re.escape(sentence)) as refused:
        chosen(str(tmp_path), "newest")
    assert "found the setting 'phi'" in str(refused.value)
    assert "install the version that wrote it" in str(refused.value)
