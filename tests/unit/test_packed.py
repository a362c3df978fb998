"""Arrays of several environments as few ones, and back."""

import numpy as np

from workers.snapshots import packed, unpacked


def test_rows_share_arrays_where_they_are_alike_and_come_back_one_by_one():
    rows = [
        {"obs": np.arange(3.0), "actions": np.zeros((2, 1)), "last": np.ones(2)},
        {"obs": np.arange(3.0) + 9, "actions": np.ones((5, 1))},
    ]
    arrays = packed(rows) | {"replay/obs": np.zeros(4)}
    assert {name: array.shape for name, array in arrays.items()} == {
        "obs": (2, 3), "0/actions": (2, 1), "1/actions": (5, 1), "0/last": (2,),
        "replay/obs": (4,),
    }  # fmt: skip
    back = unpacked(arrays, 2)
    assert [set(row) for row in back] == [set(row) for row in rows]
    for row, found in zip(rows, back, strict=True):
        for name, array in row.items():
            np.testing.assert_array_equal(found[name], array)
