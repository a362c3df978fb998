"""Which samples an update uses: every pass is one permutation, drawn from its place."""

import numpy as np

from dppo.config import Config, RolloutConfig, UpdateConfig
from dppo.gradients import Minibatches


def _passes(policy=2, critics=4, epochs=2):
    return Config(
        rollout=RolloutConfig(slots=2, num_envs=2, num_steps=6),
        update=UpdateConfig(
            update_epochs=epochs, num_minibatches=policy, critic_minibatches=critics
        ),
    )


def test_every_pass_uses_every_sample_once():
    config = _passes()
    minibatches = Minibatches(config, 3)
    for first in (0, 2):
        used = [minibatches.of(1, first + k, 12).policy for k in range(2)]
        assert [len(rows) for rows in used if rows is not None] == [6, 6]
        assert sorted(np.concatenate([rows for rows in used if rows is not None])) == list(
            range(12)
        )


def test_policy_rows_end_with_its_updates_and_the_critics_go_on_over_replayed_samples():
    config = _passes()  # 4 updates of the policy, 8 of the critics
    batches = [Minibatches(config, 0).of(0, update, 24) for update in range(9)]
    assert [batch.policy is None for batch in batches] == [False] * 4 + [True] * 5
    assert batches[8].critics is None
    seen = [batch.critics for batch in batches[:4]]
    assert sorted(np.concatenate([rows for rows in seen if rows is not None])) == list(range(24))


def test_orders_differ_by_slot_iteration_and_pass_and_repeat_exactly():
    config = _passes()

    def order(slot, iteration, update):
        rows = Minibatches(config, iteration).of(slot, update, 12).policy
        assert rows is not None
        return rows.tolist()

    places = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 2)]
    orders = [order(*place) for place in places]
    assert len({tuple(rows) for rows in orders}) == 4
    assert orders == [order(*place) for place in places]


def test_a_full_batch_is_taken_in_time_order():
    rows = Minibatches(_passes(policy=1, critics=1), 0).of(0, 1, 12)
    assert rows.policy is not None
    assert rows.critics is not None
    assert rows.policy.tolist() == rows.critics.tolist() == list(range(12))
