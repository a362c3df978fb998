"""How an environment fails, from the row of a vector up to the slot."""

from dppo.errors import RunFailedError


class RowFailedError(Exception):
    """A row of a vector environment raised, or returned what does not fit."""

    def __init__(self, row: int, what: str) -> None:
        super().__init__(f"environment {row} {what}")
        self.row, self.what = row, what


class EnvironmentFailedError(Exception):
    """An environment raised, or returned what is not a number; slot, environment, step named."""

    def __init__(self, slot: int, reason: str) -> None:
        super().__init__(reason)
        self.slot = slot


def failed_episode(name: str, what: str, step: int, seed: int) -> RunFailedError:
    """The sentence for an episode that nobody learns from: where it failed, and how to see it."""
    return RunFailedError(f"{name} {what} at step {step} of an episode with reset seed {seed}")
