"""One learner per run: an older one stops when it hears of a newer one.

Workers remember the highest generation of a run that they have served, and say so in `Hello`. The
folder remembers it, too: a learner whose folder has a newer generation writes nothing more there.
"""

from dppo.errors import SupersededError
from dppo.wire.messages import Hello, Welcome


def check_served(hello: Hello, welcome: Welcome) -> None:
    """Stop if the worker comes from a later learner of this run.

    Raises:
        SupersededError: it has served a higher generation of the run.
    """
    if hello.served_run == welcome.run and hello.served_generation > welcome.generation:
        raise SupersededError(
            f"worker {hello.worker} on {hello.host} has served generation "
            f"{hello.served_generation} of run {welcome.run}, this learner is generation "
            f"{welcome.generation}: either another learner has gone on with the run, or this "
            "folder is an old copy of the run's; continue in the folder of the newest generation",
            hello.served_generation,
        )
