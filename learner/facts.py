"""What decides the bits of a run besides settings and seed."""

import logging
from pathlib import Path
from typing import Any

from dppo.errors import UsageError
from dppo.sources import versions
from learner.roster import Roster

log = logging.getLogger("learner")


def sizes(roster: Roster) -> dict[str, Any]:
    """Of the environment that a worker has built."""
    ready = roster.first
    assert ready is not None
    return {
        "obs_size": ready.obs_size,
        "action_kind": ready.action_kind,
        "action_sizes": list(ready.action_sizes),
    }


def run_facts(roster: Roster, code: str) -> dict[str, Any]:
    """Versions, processor and environment, as config.json has them."""
    ready = roster.first
    assert ready is not None
    return {
        "versions": versions(),
        "code": code,
        "numerics": roster.numerics,
        "environment": {
            **sizes(roster),
            "model_xml_sha256": ready.env_hash,
            "moves_by": ready.exact,
        },
    }


def check_environment(before: dict[str, Any], now: dict[str, Any], path: Path) -> bool:
    """A run goes on, or again, in the environment it had; other versions are worth a warning.

    Returns:
        Whether code, versions and floating point are those of before.

    Args:
        before, now: `run_facts`.
        path: of the run.

    Raises:
        UsageError: sizes, model or snapshots are not the run's.
    """
    if before.get("environment") != now["environment"]:
        raise UsageError(
            f"{path} was trained on another environment: {before['environment']} "
            f"then, {now['environment']} now; install the versions it names: "
            f"{before['versions']}"
        )
    changed = [name for name in ("code", "versions", "numerics") if before.get(name) != now[name]]
    for name in changed:
        log.warning(
            "%s: %s before, %s now; do not expect the bits of an undisturbed run",
            name,
            before.get(name),
            now[name],
        )
    return not changed
