"""What a person sees: a bar on a terminal, plain lines elsewhere."""

import contextlib
import sys
import time
from typing import Any

from dppo.config import Config
from dppo.process import say
from learner.report import IterationReport

_PLAIN_SECONDS = 1.0
"""Plain lines come no faster than this."""


class Console:
    """Progress of one run."""

    def __init__(self, config: Config, done_steps: int) -> None:
        self._total = config.iterations * config.rollout.samples
        self._begun, self._begun_steps = time.monotonic(), done_steps
        self._last_line = 0.0
        self._bar: Any = None
        if sys.stdout.isatty():
            self._start_bar(done_steps)

    def show(self, report: IterationReport, speed: float) -> None:
        """The newest iteration; `speed` in environment steps per second."""
        text = _line(report, speed)
        if self._bar is not None:
            self._bar.update(self._task, completed=report.env_steps, figures=text)
            return
        now = time.monotonic()
        over = report.env_steps >= self._total
        if not over and now - self._last_line < _PLAIN_SECONDS:
            return
        self._last_line = now
        share = report.env_steps / self._total
        pace = (report.env_steps - self._begun_steps) / max(now - self._begun, 1e-9)
        left = _clock((self._total - report.env_steps) / max(pace, 1e-9))
        say(f"{share:6.1%}  {report.env_steps:>10,} steps  left {left}  {text}")

    def close(self) -> None:
        """Leave the terminal as it was, if it is still there."""
        if self._bar is not None:
            with contextlib.suppress(OSError):
                self._bar.stop()

    def _start_bar(self, done_steps: int) -> None:
        from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

        self._bar = Progress(
            BarColumn(bar_width=24),
            TextColumn("{task.percentage:5.1f} %"),
            TimeRemainingColumn(),
            TextColumn("{task.fields[figures]}"),
        )
        self._task = self._bar.add_task("train", total=self._total, figures="starting")
        self._bar.update(self._task, completed=done_steps)
        self._bar.start()


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


def _clock(seconds: float) -> str:
    minutes, rest = divmod(int(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}"
