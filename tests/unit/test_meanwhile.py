"""Work that waits until the workers are busy."""

import pytest

from learner.meanwhile import Meanwhile


def test_jobs_are_done_once_and_in_order_also_those_that_a_job_adds():
    meanwhile, done = Meanwhile(), []

    def first() -> None:
        done.append(1)
        meanwhile.add(lambda: done.append(3))

    meanwhile.add(first)
    meanwhile.add(lambda: done.append(2))
    assert done == []
    meanwhile.do()
    meanwhile.do()
    assert done == [1, 2, 3]


def test_a_job_that_raises_is_not_tried_again_and_the_others_are_kept():
    meanwhile, done = Meanwhile(), []
    meanwhile.add(lambda: [][0])
    meanwhile.add(lambda: done.append(2))
    with pytest.raises(IndexError):
        meanwhile.do()
    assert done == []
    meanwhile.do()
    assert done == [2]
