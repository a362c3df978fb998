"""Learning curves as in figures 6 to 9, and returns within policies; one picture each."""

import io
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from dppo.experiment.measure import Cell, curve_of
from dppo.files import replace_durably, safe_name
from dppo.four_rooms.style import BLUE, GREY, INK, RED, figure, look

DPI = 150
_COLOURS = (INK, RED, BLUE, "#009e73", "#cc79a7", GREY, "#e69f00")
_WIDTH, _HEIGHT = 5.0, 3.0


def save_figures(folder: Path, cells: Sequence[Cell]) -> list[tuple[str, str]]:
    """Write the pictures that the finished runs allow; names and captions."""
    written = []
    with look():
        for name, caption, drawing in _all(cells):
            picture = io.BytesIO()
            drawing.savefig(picture, format="png", dpi=DPI)
            replace_durably(folder / name, picture.getvalue())
            written.append((name, caption))
    return written


def _all(cells: Sequence[Cell]) -> Iterator[tuple[str, str, Any]]:
    for env in dict.fromkeys(cell.env for cell in cells):
        arms = [cell for cell in cells if cell.env == env and cell.finished]
        if any(curve_of(cell) is not None for cell in arms):
            yield (
                f"curves-{safe_name(env)}.png",
                f"{env}: mean return of the last 100 training episodes; mean and one standard "
                "deviation over the seeds, all arms.",
                _curves(env, arms),
            )
        evaluated = [cell for cell in arms if cell.evaluated("free", "return") is not None]
        if evaluated:
            yield (
                f"policies-{safe_name(env)}.png",
                f"{env}: returns of evaluation episodes of the final policies, free starts; one "
                "column a seed. Bar: from the 10th to the 90th percentile; line: the median; "
                "dots: the worst tenth.",
                _policies(env, evaluated),
            )


def _curves(env: str, arms: Sequence[Cell]) -> Any:  # noqa: ANN401  matplotlib's figure
    drawing, (axes,) = figure(_WIDTH, _HEIGHT)
    for cell, colour in zip(arms, _cycle(len(arms)), strict=True):
        curve = curve_of(cell)
        if curve is None:
            continue
        steps = curve["steps"] / 1e6
        seeds = len(cell.finished)
        plural = "seed" if seeds == 1 else "seeds"
        axes.plot(steps, curve["mean"], color=colour, label=f"{cell.label}, {seeds} {plural}")
        band = np.nan_to_num(curve["std"])
        low, high = curve["mean"] - band, curve["mean"] + band
        axes.fill_between(steps, low, high, color=colour, alpha=0.15, linewidth=0)
    axes.set_title(env)
    axes.set_xlabel("environment steps [million]")
    axes.set_ylabel("return")
    axes.legend(frameon=False, loc="best")
    return drawing


def _policies(env: str, arms: Sequence[Cell]) -> Any:  # noqa: ANN401  matplotlib's figure
    drawing, (axes,) = figure(_WIDTH, _HEIGHT)
    at, ticks = 0.0, []
    for cell, colour in zip(arms, _cycle(len(arms)), strict=True):
        returns = cell.evaluated("free", "return")
        assert returns is not None
        ticks.append((at + (len(returns) - 1) / 2, cell.label))
        for row in returns:
            low, middle, high = np.quantile(row, (0.1, 0.5, 0.9))
            axes.plot([at, at], [low, high], color=colour, linewidth=3, solid_capstyle="butt")
            axes.plot([at - 0.35, at + 0.35], [middle, middle], color=colour)
            worst = np.sort(row)[: max(1, -(-len(row) // 10))]
            axes.plot(np.full(len(worst), at), worst, ".", color=colour, markersize=2)
            at += 1
        at += 1
    axes.set_title(env)
    axes.set_xticks([place for place, _ in ticks], [label for _, label in ticks])
    axes.set_ylabel("return of an episode")
    return drawing


def _cycle(count: int) -> list[str]:
    return [_COLOURS[place % len(_COLOURS)] for place in range(count)]
