"""What a person sees: a bar on a terminal, plain lines elsewhere.

In a thread of its own: a terminal that takes nothing for a while (Ctrl-S, a lost connection, a
pager) costs lines, and no time.
"""

import sys
import time
from concurrent.futures import Future, ThreadPoolExecutor, wait
from typing import Any

from dppo.config import Config
from dppo.process import clock, say
from learner.report import IterationReport

_PLAIN_SECONDS, _BAR_SECONDS = 1.0, 0.1
"""Lines, and states of the bar, come no faster than this."""
_CLOSE_SECONDS = 1.0
"""For the last of them."""


class Console:
    """Progress of one run."""

    def __init__(self, config: Config, done_steps: int) -> None:
        self._total = config.env_steps(config.iterations)
        self._begun, self._begun_steps = time.monotonic(), done_steps
        self._thread = ThreadPoolExecutor(1)
        self._drawing: Future[None] | None = None
        self._left_out: tuple[IterationReport, float] | None = None
        """The newest, if it has not been drawn."""
        self._drawn = 0.0
        self._bar: Any = None
        self._pause = _PLAIN_SECONDS
        if sys.stdout.isatty():
            self._start_bar(done_steps)
            self._pause = _BAR_SECONDS

    def show(self, report: IterationReport, speed: float) -> None:
        """The newest iteration; `speed` in environment steps per second."""
        over = report.env_steps >= self._total
        if self._is_free() and (over or time.monotonic() - self._drawn >= self._pause):
            self._draw(report, speed)
        else:
            self._left_out = report, speed

    def close(self) -> None:
        """Draw the end, and leave the terminal as it was, if it is still there."""
        if self._drawing is not None:
            wait([self._drawing], _CLOSE_SECONDS)
        if not self._is_free():
            return
        if self._left_out is not None:
            self._draw(*self._left_out)
        if self._bar is not None:
            wait([self._thread.submit(self._bar.stop)], _CLOSE_SECONDS)
        elif self._drawing is not None:
            wait([self._drawing], _CLOSE_SECONDS)

    def _is_free(self) -> bool:
        return self._drawing is None or self._drawing.done()

    def _draw(self, report: IterationReport, speed: float) -> None:
        self._left_out, self._drawn = None, time.monotonic()
        self._drawing = self._thread.submit(self._draw_now, report, speed, self._drawn)

    def _draw_now(self, report: IterationReport, speed: float, now: float) -> None:
        """In the thread only, whose errors nobody asks for: the terminal may be gone."""
        text = _line(report, speed)
        if self._bar is not None:
            self._bar.update(self._task, completed=report.env_steps, figures=text, refresh=True)
            return
        share = report.env_steps / self._total
        pace = (report.env_steps - self._begun_steps) / max(now - self._begun, 1e-9)
        left = clock((self._total - report.env_steps) / max(pace, 1e-9))
        say(f"{share:6.1%}  {report.env_steps:>10,} steps  left {left}  {text}")

    def _start_bar(self, done_steps: int) -> None:
        from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

        self._bar = Progress(
            BarColumn(bar_width=24),
            TextColumn("{task.percentage:5.1f} %"),
            TimeRemainingColumn(),
            TextColumn("{task.fields[figures]}"),
            auto_refresh=False,  # its own thread would hold a lock while the terminal waits
        )
        self._task = self._bar.add_task("train", total=self._total, figures="starting")
        self._bar.update(self._task, completed=done_steps)
        self._drawing = self._thread.submit(self._bar.start)


def _line(report: IterationReport, speed: float) -> str:
    """Speed, return with its spread, KL, σ, workers."""
    metrics = report.metrics
    score = "return    -"
    if "rollout/ep_rew_mean" in metrics:
        mean, spread = metrics["rollout/ep_rew_mean"], metrics["safety/return_std"]
        score = f"return {mean:8.1f} ± {spread:<6.1f}"
    kl, beta = metrics["train/kl"], metrics["train/kl_coef"]
    return (
        f"{speed:7,.0f}/s  {score}  KL {kl:.4f}  β {beta:5.2f}"
        f"  σ {metrics['safety/sigma_mean']:.3g}  ψ {metrics['safety/psi']:g}"
        f"  workers {metrics['cluster/workers']:.0f}"
    )
