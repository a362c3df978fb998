"""What a run's checkpoint says, in the algorithm's own terms."""

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
