"""Errors that the world can cause.

    DppoError
    ├── UsageError        the user asked for something impossible        -> exit code 2
    │   └── SupersededError   another learner has gone on with the run
    ├── WireError         a message is not one of ours
    ├── CheckpointError   a file is not what was written
    └── RunFailedError    training cannot go on                          -> exit code 1

`ValueError` stays what a wrong argument or setting raises.
"""


class DppoError(Exception):
    """Base of all. The text is one sentence: what, found, expected, what to do."""


class UsageError(DppoError):
    """The user asked for something impossible; the process exits with code 2."""


class SupersededError(UsageError):
    """Another learner has gone on with this run: this one writes nothing more."""

    def __init__(self, sentence: str, newest: int = 0) -> None:
        """`newest`: the highest generation that is known; 0: not known."""
        super().__init__(sentence)
        self.newest = newest


class WireError(DppoError):
    """Bytes that are not a message of this protocol version."""


class CheckpointError(DppoError):
    """A checkpoint that is missing, torn, altered or of another format."""


class RunFailedError(DppoError):
    """Training cannot go on; what was reached is safe."""
