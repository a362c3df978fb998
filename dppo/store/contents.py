"""What a run's checkpoint says, in the algorithm's own terms."""

from pathlib import Path

from dppo.config import Config
from dppo.errors import CheckpointError, UsageError
from dppo.normalizer import Statistics
from dppo.sources import made_by
from dppo.spaces import Spaces
from dppo.store.checkpoint import Checkpoint, best_name, load_checkpoint, names


def config_in(checkpoint: Checkpoint) -> Config:
    """Settings of the run.

    Raises:
        UsageError: another version of dppo wrote one that this version does not have.
    """
    try:
        return Config.from_dict(checkpoint.facts["config"])
    except ValueError as error:
        writer, ours = checkpoint.facts.get("made_by"), made_by()
        raise UsageError(
            f"the checkpoint was written by {_named(writer) if writer else 'another version'}, "
            f"this is {_named(ours)}: {error}; install the version that wrote it"
        ) from error


def _named(maker: dict[str, str]) -> str:
    return f"dppo {maker['dppo']} (code {maker['code']})"


def spaces_in(checkpoint: Checkpoint) -> Spaces:
    """Sizes of the environment that was trained on."""
    facts = checkpoint.facts["spaces"]
    return Spaces(**facts | {"action_sizes": tuple(facts["action_sizes"])})


def statistics_in(checkpoint: Checkpoint) -> Statistics:
    """The statistics that all workers share."""
    arrays = checkpoint.arrays
    return Statistics.from_vectors(
        *(arrays[f"statistics/{name}"] for name in ("obs", "returns", "sigma_target"))
    )


def mean_reward(checkpoint: Checkpoint) -> float:
    """Mean reward of a step, over the iteration before; of earlier versions, of its episodes."""
    known = checkpoint.facts.get("state", {}).get("mean_reward")
    if known is not None:
        return float(known)
    episodes = checkpoint.arrays["episodes"]
    return float(episodes[:, 0].sum() / episodes[:, 1].sum()) if len(episodes) else 0.0


def is_checkpoint(path: Path) -> bool:
    """A folder that is one checkpoint, not a run's."""
    return (path / "manifest.json").exists()


def chosen(run: str, which: str) -> tuple[Path, Checkpoint]:
    """The checkpoint that was asked for, and where it lies.

    Args:
        run: run directory, or one checkpoint folder in it.
        which: best, newest, or a checkpoint's name.

    Raises:
        UsageError: there is none, or none that this version can read; says what was looked for
            and what is there.
    """
    path = Path(run)
    hint = "choose another one"
    if not is_checkpoint(path):
        folder = path / "checkpoints"
        found = names(folder)
        if not found:
            raise UsageError(
                f"{run} holds no checkpoint; expected a run directory of dppo-learner"
            )
        name = {"best": best_name(folder) or found[-1], "newest": found[-1]}.get(which, which)
        if name not in found:
            raise UsageError(f"--which is {which}, expected best, newest, or {', '.join(found)}")
        path, hint = folder / name, f"{hint} with --which"
    try:
        checkpoint = load_checkpoint(path)
    except CheckpointError as error:
        raise UsageError(f"{error}; {hint}") from error
    config_in(checkpoint)
    return path, checkpoint


def was_exact(checkpoint: Checkpoint) -> bool:
    """No slot had lost a bit on a move; so of those that earlier versions wrote."""
    return bool(checkpoint.facts.get("exact", True))


SNAPSHOT_FORM = 3
"""Of the slots' snapshots: 1 until environments were batched, 2 until they shared arrays."""


def check_snapshots(checkpoint: Checkpoint) -> None:
    """Refuse to go on from snapshots that today's workers cannot restore.

    Raises:
        UsageError: an earlier or later version wrote them.
    """
    form = checkpoint.facts.get("snapshots", 1)
    if form != SNAPSHOT_FORM:
        raise UsageError(
            f"the run's environments were saved in form {form}, this version restores form "
            f"{SNAPSHOT_FORM}; finish the run with the dppo version that began it, or begin anew "
            "with another --run-dir (dppo eval reads its checkpoints all the same)"
        )
