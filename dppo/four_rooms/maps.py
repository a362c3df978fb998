"""Figures that are maps of the rooms: the world, visits, policies, trajectories."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap, PowerNorm
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle
from numpy.typing import NDArray

from dppo.four_rooms.mdp import Floats
from dppo.four_rooms.style import BLUE, FROZEN, GOAL, INK, RED, TEXT_WIDTH, WALL, figure
from dppo.four_rooms.world import World

Cells = NDArray[np.intp]


def map_figure(world: World) -> Figure:
    """The paper's figure 1."""
    drawing, (axes,) = figure(2.6, 2.45)
    _rooms(axes, world)
    row, column = world.cells[world.goal]
    axes.text(column, row, "G", ha="center", va="center", color="white", weight="bold")
    for row, column in world.cells[world.frozen]:
        axes.text(column, row, "F", ha="center", va="center", color=INK, size=7)
    axes.set_xticks(range(0, world.shape[1], 2))
    axes.set_yticks(range(0, world.shape[0], 2))
    axes.set(xlabel="column", ylabel="row")
    axes.legend(
        handles=[
            Patch(facecolor=FROZEN, edgecolor=INK, lw=0.4, label="frozen"),
            Patch(color=GOAL, label="goal"),
            Patch(color=WALL, label="wall"),
        ],
        loc="upper center", bbox_to_anchor=(0.5, 1.13), ncols=3, frameon=False, handlelength=1,
    )  # fmt: skip
    return drawing


def visits_figure(world: World, shares: Sequence[tuple[str, Floats]]) -> Figure:
    """The paper's figure 3: where test episodes spend their time, in percent."""
    drawing, panels = figure(TEXT_WIDTH, 1.6, columns=len(shares))
    top = 100 * max(share.max() for _, share in shares)
    norm = PowerNorm(0.5, vmin=0, vmax=top)  # differences among rare cells stay visible
    for axes, (title, share) in zip(panels, shares, strict=True):
        _rooms(axes, world, plain=True)
        grid = np.full(world.shape, np.nan)
        grid[tuple(world.cells.T)] = 100 * share
        image = axes.imshow(grid, cmap="Blues", norm=norm)
        for row, column in world.cells[world.frozen]:
            _box(axes, row, column, edgecolor=RED, facecolor="none", lw=0.6)
        axes.set_title(title)
        _no_ticks(axes)
    bar = drawing.colorbar(image, ax=panels, fraction=0.05, pad=0.02, shrink=0.8)
    bar.set_label("share of time [%]")
    ticks = [tick for tick in (0, 0.5, 1, 2, 4, 8, 16, 32) if tick <= top]
    bar.set_ticks(ticks, labels=[f"{tick:g}" for tick in ticks])
    bar.outline.set_linewidth(0.4)
    return drawing


def policies_figure(world: World, policies: Sequence[tuple[str, Floats]]) -> Figure:
    """The paper's figure 4: the likeliest action of each cell."""
    rows = (len(policies) + 1) // 2
    drawing, panels = figure(TEXT_WIDTH, 1.8 * rows, columns=2, rows=rows)
    across, down = np.array([(0, 1), (0, -1), (-1, 0), (1, 0)]).T  # up, down, left, right
    for axes, (title, policy) in zip(panels, policies, strict=True):
        _rooms(axes, world)
        cells = np.delete(np.arange(world.states), world.goal)
        action = policy[cells].argmax(axis=1)
        axes.quiver(
            world.cells[cells, 1], world.cells[cells, 0], across[action], down[action],
            color=INK, pivot="mid", scale=1.35, scale_units="x", width=0.012, headwidth=4,
            headlength=4, headaxislength=3.6,
        )  # fmt: skip
        axes.set_title(title)
        _no_ticks(axes)
    return drawing


def trajectories_figure(world: World, walks: Sequence[tuple[str, Sequence[Cells]]]) -> Figure:
    """The paper's figure 5: sampled episodes, S to G."""
    drawing, panels = figure(TEXT_WIDTH, 1.8, columns=len(walks))
    for axes, (title, episodes) in zip(panels, walks, strict=True):
        _rooms(axes, world)
        for number, (cells, colour) in enumerate(zip(episodes, (BLUE, RED), strict=False)):
            shift = 0.14 * (2 * number - 1)  # side by side where both pass
            column, row = world.cells[cells, 1] + shift, world.cells[cells, 0] + shift
            axes.plot(column, row, color=colour, lw=1.1, solid_joinstyle="round")
            axes.plot(column[0], row[0], "o", color=colour, ms=7.5)
            axes.text(
                column[0], row[0] - 0.03, "S",
                color="white", size=7, ha="center", va="center_baseline",
            )  # fmt: skip
        row, column = world.cells[world.goal]
        axes.text(column, row, "G", color="white", weight="bold", ha="center", va="center")
        axes.set_title(title)
        _no_ticks(axes)
    return drawing


def _rooms(axes: Axes, world: World, plain: bool = False) -> None:
    """Walls, ice and goal; `plain`: only the walls."""
    kinds = np.zeros(world.shape, int)
    free = tuple(world.cells.T)
    kinds[free] = 1
    if not plain:
        kinds[free] += world.frozen
        kinds[tuple(world.cells[world.goal])] = 3
    axes.imshow(kinds, cmap=ListedColormap([WALL, "white", FROZEN, GOAL]), vmin=0, vmax=3)
    for row, column in world.cells:
        _box(axes, row, column, edgecolor="#d0d0d0", facecolor="none", lw=0.25)


def _box(axes: Axes, row: int, column: int, **looks: Any) -> None:  # noqa: ANN401  matplotlib's
    axes.add_patch(Rectangle((column - 0.5, row - 0.5), 1, 1, **looks))


def _no_ticks(axes: Axes) -> None:
    axes.set_xticks([])
    axes.set_yticks([])
