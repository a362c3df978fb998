"""Fixtures of tests that do something to a whole run."""

import pytest

from tests.support import Harness


@pytest.fixture(scope="module")
def undisturbed(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> str:
    """The hash of the module's RUN when nothing happens to it."""
    harness = Harness(tmp_path_factory.mktemp("undisturbed"))
    outcome = harness.train(*request.module.RUN, run_dir=harness.folder / "run")
    return str(outcome["parameters_sha256"])
