"""Moments: whatever is merged in whatever order, it is the moments of all of it."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dppo.moments import Moments

SIZE = 2
numbers = st.floats(-1e3, 1e3, allow_subnormal=False)
rows = st.lists(st.tuples(*[numbers] * SIZE), max_size=30).map(
    lambda values: np.array(values, np.float64).reshape(-1, SIZE)
)
quick = settings(deadline=None, max_examples=60)


def assert_same(one, other, *seen):
    """Equal to 1e-12 of what the sums are made of: values for means, squares for m2."""
    largest = max(float(np.abs(values).max(initial=1.0)) for values in seen)
    total = max(one.count, 1.0)
    assert one.count == other.count
    np.testing.assert_allclose(one.mean, other.mean, rtol=0, atol=1e-12 * largest)
    np.testing.assert_allclose(one.m2, other.m2, rtol=0, atol=1e-12 * largest**2 * total)


def test_moments_of_four_numbers():
    found = Moments.of(np.array([1.0, 3.0, 5.0, 7.0]))
    assert found.count == 4
    assert found.mean == [4.0]
    assert found.m2 == [9 + 1 + 1 + 9]
    assert found.std() == [np.sqrt(5.0)]


def test_merge_of_two_parts_by_hand():
    left, right = Moments.of(np.array([1.0, 3.0])), Moments.of(np.array([9.0]))
    both = left.merge(right)
    assert both.count == 3
    # mean 2 of two and 9 of one: 2 + 7 * 1/3; squares (1 + 1) + 0 + 7² * 2*1/3
    assert both.mean == [2 + 7 * (1 / 3)]
    assert both.m2 == [2 + 49 * (2 / 3)]


@quick
@given(rows, rows)
def test_merged_moments_are_the_moments_of_the_pooled_rows(a, b):
    pooled = np.concatenate([a, b])
    assert_same(Moments.of(a).merge(Moments.of(b)), Moments.of(pooled), a, b)


@quick
@given(rows, rows, rows)
def test_merging_is_associative(a, b, c):
    one, two, three = Moments.of(a), Moments.of(b), Moments.of(c)
    assert_same(one.merge(two).merge(three), one.merge(two.merge(three)), a, b, c)


@quick
@given(rows)
def test_merging_with_nothing_changes_no_bit(a):
    some, nothing = Moments.of(a), Moments.empty(SIZE)
    for merged in (some.merge(nothing), nothing.merge(some)):
        assert merged.to_vector().tobytes() == (some.to_vector() + 0.0).tobytes()


@quick
@given(rows, st.sampled_from([-2.0, 0.0, 0.5, 4.0]))
def test_scaled_moments_are_the_moments_of_scaled_rows(a, factor):
    assert_same(Moments.of(a).scaled(factor), Moments.of(a * factor), a, a * factor)


@quick
@given(rows)
def test_the_vector_gives_the_moments_back(a):
    before = Moments.of(a)
    vector = before.to_vector()
    assert len(vector) == 1 + 2 * SIZE
    after = Moments.from_vector(vector)
    vector[:] = np.nan  # the moments keep their own numbers
    assert after.count == before.count
    assert after.mean.tobytes() == before.mean.tobytes()
    assert after.m2.tobytes() == before.m2.tobytes()


def test_the_vector_is_count_then_mean_then_m2():
    found = Moments.of(np.array([[0.0, 10.0], [2.0, 30.0]])).to_vector()
    assert found.tolist() == [2.0, 1.0, 20.0, 2.0, 200.0]


@pytest.mark.parametrize("shape", [(0, 3), (0,)])
def test_no_rows_are_empty_moments(shape):
    found = Moments.of(np.zeros(shape))
    assert found.count == 0
    assert found.std().tolist() == [1.0] * (shape[1] if len(shape) > 1 else 1)


def test_the_std_has_a_floor_only_where_something_was_seen():
    constant = Moments.of(np.array([5.0, 5.0]))
    assert constant.std() == [1e-8]
    assert constant.std(floor=0.25) == [0.25]
    assert Moments.empty(1).std(floor=2.0) == [1.0]


def test_single_precision_rows_are_counted_in_double_precision():
    rows = np.full(100_000, np.float32(0.1))
    assert Moments.of(rows).mean == pytest.approx(float(np.float32(0.1)), rel=1e-15 * 1000)
    assert Moments.of(rows).m2.dtype == np.float64
