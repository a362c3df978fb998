"""Work of the learner that can wait until the workers are busy."""

from collections import deque
from collections.abc import Callable


class Meanwhile:
    """Jobs in the order in which they were given.

    Example:
        meanwhile.add(lambda: runlog.write(report, measured))
        exchange.gather(collect, quorum=8)  # asks, writes, waits
    """

    def __init__(self) -> None:
        self._jobs: deque[Callable[[], object]] = deque()

    def add(self, job: Callable[[], object]) -> None:
        """Leave a job for the next time that the workers have something to do."""
        self._jobs.append(job)

    def do(self) -> None:
        """Do all of them now. What one raises is raised, and that one is not tried again."""
        while self._jobs:
            self._jobs.popleft()()
