"""How figures look: the width of a column, type of at least 7 pt, the colours of Okabe and Ito."""

from typing import Any

from matplotlib import rc_context
from matplotlib.figure import Figure

TEXT_WIDTH = 3.3
"""Of a column [inches]."""
DPI = 300
BLUE, RED, GREY = "#0072b2", "#d55e00", "#7f7f7f"
GOAL, FROZEN, WALL, INK = "#009e73", "#a9d6f0", "#8c8c8c", "#1a1a1a"
LOOK: dict[Any, Any] = {
    "font.size": 7.5, "axes.titlesize": 7.5, "axes.labelsize": 7.5, "legend.fontsize": 7,
    "xtick.labelsize": 7, "ytick.labelsize": 7, "axes.linewidth": 0.6, "lines.linewidth": 1.2,
    "xtick.major.width": 0.6, "ytick.major.width": 0.6, "xtick.major.size": 2.5,
    "ytick.major.size": 2.5, "axes.titlepad": 3, "axes.labelpad": 2, "font.family": "sans-serif",
    "mathtext.fontset": "dejavusans",
}  # fmt: skip


def figure(
    width: float, height: float, *, columns: int = 1, rows: int = 1
) -> tuple[Figure, list[Any]]:
    """A figure without a window, in inches, and its axes, row by row."""
    drawing = Figure(figsize=(width, height), layout="constrained")
    drawing.get_layout_engine().set(w_pad=0.02, h_pad=0.02, wspace=0.02, hspace=0.03)  # type: ignore[union-attr,call-arg]
    return drawing, list(drawing.subplots(rows, columns, squeeze=False, sharex=True).ravel())


def look() -> Any:  # noqa: ANN401  a context manager of matplotlib's
    """The settings of all figures, for as long as they are drawn and saved."""
    return rc_context(LOOK)
