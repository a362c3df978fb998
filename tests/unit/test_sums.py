"""One tree of additions, wherever the slots run."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dppo.adam import Float32
from dppo.sums import Block, aligned_blocks, block_sum, members, sum_rows, tree_sum, whole

subsets = st.sets(st.integers(0, 15))
quick = settings(deadline=None, max_examples=50)


def leaves(slots, seed, size=7):
    """A vector per slot, of all magnitudes: any other order of additions shows."""
    rng = np.random.default_rng(seed)
    return {
        (slot, 1): (rng.standard_normal(size) * 10.0 ** rng.integers(-6, 7, size)).astype(
            np.float32
        )
        for slot in slots
    }


def sent_by_workers(parts, owner):
    """What each worker sends for the slots it owns: the sums of its aligned blocks."""
    sent: dict[Block, Float32] = {}
    for worker in set(owner.values()):
        held = [slot for slot, _ in parts if owner[slot] == worker]
        own = {(slot, 1): parts[slot, 1] for slot in held}
        sent |= {block: block_sum(own, block) for block in aligned_blocks(held)}
    return sent


@pytest.mark.parametrize(
    ("slots", "blocks"),
    [
        ([], []),
        ([5], [(5, 1)]),
        ([0, 1, 2, 3], [(0, 4)]),
        ([1, 2], [(1, 1), (2, 1)]),  # neighbours, but of different pairs
        ([0, 1, 2], [(0, 2), (2, 1)]),
        ([3, 2, 7, 6, 5, 4], [(2, 2), (4, 4)]),
        (range(1, 8), [(1, 1), (2, 2), (4, 4)]),
        (range(16), [(0, 16)]),
    ],
)
def test_blocks_by_hand(slots, blocks):
    assert aligned_blocks(slots) == blocks


@quick
@given(subsets)
def test_blocks_are_aligned_and_hold_exactly_the_slots_in_order(slots):
    blocks = aligned_blocks(slots)
    assert [slot for block in blocks for slot in members(block)] == sorted(slots)
    for first, size in blocks:
        assert size & (size - 1) == 0
        assert first % size == 0


def test_no_cover_of_any_8_slots_needs_fewer_blocks():
    blocks = [(first, size) for size in (1, 2, 4, 8) for first in range(0, 8, size)]
    masks = [sum(1 << slot for slot in members(block)) for block in blocks]
    fewest = [0]
    for wanted in range(1, 256):
        inside = [mask for mask in masks if mask & wanted == mask]
        fewest.append(1 + min(fewest[wanted ^ mask] for mask in inside))
        slots = [slot for slot in range(8) if wanted >> slot & 1]
        assert len(aligned_blocks(slots)) == fewest[wanted]


def test_the_tree_adds_pairs_first():
    huge = np.float32(1e8)  # 1e8 + 1 is 1e8 in single precision
    parts = {(k, 1): np.array([x], np.float32) for k, x in enumerate((1, huge, -huge, 1))}
    # (1 + 1e8) + (-1e8 + 1) = 0; from left to right it would be 1
    assert tree_sum(parts, whole(4)) == [0.0]


@quick
@given(st.integers(1, 16), st.integers(0, 2**32 - 1), st.data())
def test_every_partition_over_workers_gives_the_same_bits(num_slots, seed, data):
    parts = leaves(range(num_slots), seed)
    owners = st.lists(st.integers(0, 4), min_size=num_slots, max_size=num_slots)
    owner = dict(enumerate(data.draw(owners)))
    alone = block_sum(parts, whole(num_slots))
    together = block_sum(sent_by_workers(parts, owner), whole(num_slots))
    assert together.tobytes() == alone.tobytes()
    assert together.dtype == np.float32


@quick
@given(subsets.filter(bool), st.integers(0, 2**32 - 1), st.data())
def test_missing_slots_are_left_out_alike_in_every_partition(slots, seed, data):
    parts = leaves(sorted(slots), seed)
    owner = {slot: data.draw(st.integers(0, 3)) for slot in sorted(slots)}
    alone = block_sum(parts, whole(16))
    together = block_sum(sent_by_workers(parts, owner), whole(16))
    assert together.tobytes() == alone.tobytes()


@quick
@given(subsets)
def test_the_sum_counts_every_slot_once_and_no_other(slots):
    parts = {(slot, 1): np.array([2.0**slot]) for slot in slots}  # each slot is its own bit
    total = tree_sum(parts, whole(16))
    assert (0 if total is None else total[0]) == sum(2**slot for slot in slots)


def test_a_missing_slot_leaves_its_neighbour_as_it_is():
    parts = {(0, 1): np.array([1.0]), (3, 1): np.array([4.0])}
    assert tree_sum(parts, (0, 2)) == [1.0]
    assert tree_sum(parts, whole(4)) == [5.0]


def test_nothing_at_all_sums_to_none():
    assert tree_sum({}, whole(8)) is None
    assert tree_sum({(0, 2): np.ones(1)}, (2, 2)) is None


def test_a_block_sum_of_nothing_is_refused():
    with pytest.raises(ValueError, match=r"no part of block \(4, 4\) is among \[\(0, 4\)\]"):
        block_sum({(0, 4): np.ones(1)}, (4, 4))


def test_summing_changes_no_part():
    parts = leaves(range(4), 1)
    before = {block: part.copy() for block, part in parts.items()}
    block_sum(parts, whole(4))
    assert all(np.array_equal(parts[block], before[block]) for block in parts)


@pytest.mark.parametrize(
    ("slots", "size"), [(1, 1), (2, 2), (3, 4), (8, 8), (9, 16), (4096, 4096)]
)
def test_the_root_is_the_next_power_of_two(slots, size):
    assert whole(slots) == (0, size)


@pytest.mark.parametrize("size", [1, 2, 4, 8])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_sum_of_rows_is_the_sum_of_the_tree_to_the_bit(size, dtype):
    rows = np.random.default_rng(size).normal(size=(size, 1001)).astype(dtype)
    leaves = {(slot, 1): row for slot, row in enumerate(rows)}
    assert sum_rows(rows).tobytes() == block_sum(leaves, (0, size)).tobytes()
