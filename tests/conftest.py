"""Fixtures shared by several tests. Threads are set before NumPy is imported, as in a process."""

import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import settings

from dppo.machine import one_thread

one_thread()
# Started in the background they would have it ignored, and so would the processes that they start.
signal.signal(signal.SIGINT, signal.default_int_handler)

from tests.support import SMALL, Harness  # noqa: E402  after the threads

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


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """A small run of an environment with these words, trained when it is first asked for."""
    harness, found = Harness(tmp_path_factory.mktemp("trained")), dict[tuple[str, ...], Path]()

    def run(env_id: str, *words: str) -> Path:
        key = (env_id, *words)
        if key not in found:
            run_dir = harness.folder / f"run{len(found)}"
            steps = ("--total-timesteps", "1536", "--local-workers", "1")
            harness.train("--env", env_id, *SMALL, *steps, *words, run_dir=run_dir)
            found[key] = run_dir
        return found[key]

    return run


@pytest.fixture
def quiet_libraries() -> None:
    """Gymnasium and MuJoCo as in a worker: their remarks are no warnings."""
    from workers.envs import quiet

    quiet()


@pytest.fixture(scope="session")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple["Folder", dict[str, Any], str]:
    """See `whole_grid`; its folder is shared by all tests."""
    from tests.experiment_folders import whole_grid

    found: tuple[Folder, dict[str, Any], str] = whole_grid(tmp_path_factory.mktemp("whole"))
    return found
