"""How long the rest of a grid takes. Knows no clock."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from dppo.experiment.plan import guessed_seconds_per_step

_ENOUGH_SECONDS = 5.0
"""A run is measured when it has run so long: before that it mostly starts."""


@dataclass(slots=True)
class GridPace:
    """Seconds per step of one run on each environment, as measured beside the other runs."""

    jobs: int
    _steps: dict[str, float] = field(default_factory=dict)
    _seconds: dict[str, float] = field(default_factory=dict)

    def ended(self, env: str, steps: float, seconds: float) -> None:
        """A run made so many steps in so much time."""
        self._steps[env] = self._steps.get(env, 0.0) + steps
        self._seconds[env] = self._seconds.get(env, 0.0) + seconds

    def seconds_per_step(
        self, env: str, now: Mapping[str, tuple[float, float]] | None = None
    ) -> float:
        """Measured on this environment, or guessed from others; `now`: of what is running."""
        totals = self._totals(now or {})
        if env in totals:
            steps, seconds = totals[env]
            return seconds / steps
        guess = guessed_seconds_per_step(env)
        guessed = sum(steps * guessed_seconds_per_step(one) for one, (steps, _) in totals.items())
        measured = sum(seconds for _, seconds in totals.values())
        # one run has one worker: until something is measured, a share of the machine
        return guess * (measured / guessed if guessed else self.jobs)

    def left(
        self,
        rest: Iterable[tuple[str, float]],
        now: Mapping[str, tuple[float, float]] | None = None,
    ) -> float:
        """Seconds until all are done, at least those of the longest; `rest`: env and steps."""
        seconds = [steps * self.seconds_per_step(env, now) for env, steps in rest]
        return max([sum(seconds) / self.jobs, *seconds]) if seconds else 0.0

    def _totals(self, now: Mapping[str, tuple[float, float]]) -> dict[str, tuple[float, float]]:
        totals = {}
        for env in self._steps.keys() | now.keys():
            steps, seconds = now.get(env, (0.0, 0.0))
            steps += self._steps.get(env, 0.0)
            seconds += self._seconds.get(env, 0.0)
            if steps > 0 and seconds >= _ENOUGH_SECONDS:
                totals[env] = (steps, seconds)
        return totals
