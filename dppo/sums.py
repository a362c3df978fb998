"""Sums over slots along one fixed binary tree.

Leaves are slots; a node is an aligned block of 2^k of them. A process that holds a whole block
sends the block's sum, and the chief completes the tree: the same additions in the same order,
wherever the slots run. Missing slots (dropped gradients) are left out of their node.
"""

from collections.abc import Iterable, Mapping
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Scalar = TypeVar("Scalar", np.float32, np.float64)
Block = tuple[int, int]
"""(first slot, number of slots), the number a power of two that divides the first."""


def aligned_blocks(slots: Iterable[int]) -> list[Block]:
    """The fewest aligned blocks that hold exactly these slots, in order."""
    left = set(slots)
    blocks = []
    for slot in sorted(left):
        if slot not in left:
            continue
        size = 1
        while slot % (2 * size) == 0 and all(slot + k in left for k in range(2 * size)):
            size *= 2
        left.difference_update(range(slot, slot + size))
        blocks.append((slot, size))
    return blocks


def members(block: Block) -> range:
    """The slots of a block."""
    first, size = block
    return range(first, first + size)


def tree_sum(parts: Mapping[Block, NDArray[Scalar]], block: Block) -> NDArray[Scalar] | None:
    """The sum of a block from sums of blocks inside it; None if it has none.

    Args:
        parts: disjoint aligned blocks and their sums.
        block: what to sum; `whole(num_slots)` for all slots.
    """
    if block in parts:
        return parts[block]
    first, size = block
    if size == 1:
        return None
    left = tree_sum(parts, (first, size // 2))
    right = tree_sum(parts, (first + size // 2, size // 2))
    if left is None or right is None:
        return right if left is None else left
    return left + right


def block_sum(parts: Mapping[Block, NDArray[Scalar]], block: Block) -> NDArray[Scalar]:
    """The sum of a block of which at least one slot is there."""
    total = tree_sum(parts, block)
    if total is None:
        raise ValueError(f"no part of block {block} is among {sorted(parts)}")
    return total


def sum_rows(rows: NDArray[Scalar]) -> NDArray[Scalar]:
    """The sum of an aligned block whose slots are the rows [2^k, F], as `tree_sum` adds them."""
    while len(rows) > 1:
        rows = rows[0::2] + rows[1::2]
    total: NDArray[Scalar] = rows[0]
    return total


def whole(num_slots: int) -> Block:
    """The root of the tree over all slots."""
    return 0, 1 << (num_slots - 1).bit_length()
