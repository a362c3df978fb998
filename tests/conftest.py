"""Fixtures shared by several tests. Threads are set before NumPy is imported, as in a process."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from dppo.process import one_thread

one_thread()

from tests.support import Harness  # noqa: E402  after the threads


@pytest.fixture
def harness(tmp_path: Path) -> Iterator[Harness]:
    """A real learner and real workers as processes over loopback."""
    harness = Harness(tmp_path)
    yield harness
    harness.end()
