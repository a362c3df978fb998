"""Fixtures shared by several tests. Threads are set before NumPy is imported, as in a process."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import settings

from dppo.process import one_thread

one_thread()

from tests.support import Harness  # noqa: E402  after the threads

if TYPE_CHECKING:
    from dppo.experiment.folder import Folder

# The same examples every time, and no example fails for being slow on a busy machine.
settings.register_profile("steady", derandomize=True, deadline=None)
settings.load_profile("steady")


@pytest.fixture
def harness(tmp_path: Path) -> Iterator[Harness]:
    """A real learner and real workers as processes over loopback."""
    harness = Harness(tmp_path)
    yield harness
    harness.end()


@pytest.fixture(scope="session")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple["Folder", dict[str, Any], str]:
    """See `whole_grid`; its folder is shared by all tests."""
    from tests.experiment_folders import whole_grid

    found: tuple[Folder, dict[str, Any], str] = whole_grid(tmp_path_factory.mktemp("whole"))
    return found
