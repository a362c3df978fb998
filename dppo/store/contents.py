"""What a run's checkpoint says, in the algorithm's own terms."""

from dppo.errors import UsageError
from dppo.moments import Moments
from dppo.normalizer import Statistics
from dppo.spaces import Spaces
from dppo.store.checkpoint import Checkpoint


def spaces_in(checkpoint: Checkpoint) -> Spaces:
    """Sizes of the environment that was trained on."""
    facts = checkpoint.facts["spaces"]
    return Spaces(**facts | {"action_sizes": tuple(facts["action_sizes"])})


def statistics_in(checkpoint: Checkpoint) -> Statistics:
    """The statistics that all workers share."""
    arrays = checkpoint.arrays
    return Statistics(
        *(
            Moments.from_vector(arrays[f"statistics/{name}"])
            for name in ("obs", "returns", "sigma_target")
        )
    )


SNAPSHOT_FORM = 2
"""Of the slots' snapshots: 1 until environments were batched."""


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
