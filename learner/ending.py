"""How a run ends: at its last step, by a signal, or by what goes wrong; what it leaves behind."""

import contextlib
import logging

from dppo.errors import RunFailedError, SupersededError
from dppo.process import Terminated, say
from dppo.store.run_directory import RunDirectory
from learner.disk import Disk
from learner.saving import insist
from learner.session import Session
from learner.signals import StopSignals

log = logging.getLogger("learner")
_RESULT_SECONDS = 3.0


def run(session: Session, signals: StopSignals, folder: RunDirectory, stop_at: int) -> int:
    """Train, and leave result.json and a checkpoint behind however it ends."""
    try:
        result = _trained(session, stop_at)
    except SupersededError as error:
        raise folder.fence_off(error) from error
    except Exception as error:  # that of a run that cannot go on, or a bug of ours
        with contextlib.suppress(RunFailedError):  # the disk may be what failed
            session.save()
        if isinstance(error, RunFailedError) and (failed := session.interrupted()) is not None:
            _leave_result(folder, failed | {"status": "failed", "reason": str(error)})
        raise
    signals.ignore()
    if result is None:
        return 0
    _leave_result(folder, result)
    say(
        f"{result['status']}: {result['env_steps']:,} steps, parameters_sha256 "
        f"{result['parameters_sha256']}, see {folder.path / 'result.json'}"
    )
    return 0


def _trained(session: Session, stop_at: int) -> dict[str, object] | None:
    """The contents of result.json: of a run that has ended, or was stopped after it began."""
    try:
        return session.train(stop_at)
    except Terminated:
        session.save()
        result = session.interrupted()
        say("stopped; the same command with this --run-dir continues" if result else "stopped")
        return result


def _leave_result(folder: RunDirectory, result: dict[str, object]) -> None:
    """Write result.json if the disk takes it: what it says is also in the checkpoint."""
    name = "result.json"
    failures: list[OSError | None] = []
    disk = Disk(folder.path, "")
    job = disk.run(lambda: failures.append(insist(lambda: folder.write_json(name, result))))
    try:
        disk.wait(job, name, _RESULT_SECONDS)
    except OSError as error:
        failures.append(error)
    failure = failures[0]
    if failure is not None:
        log.warning(
            "result.json in %s cannot be written: %s; what it would say is printed, and in the "
            "newest checkpoint",
            folder.path,
            failure,
        )
