"""Figures over numbers: learning curves and the sweep over ψ. Draws from results.json."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from dppo.four_rooms.style import BLUE, GREY, RED, TEXT_WIDTH, figure

Summary = dict[str, Any]


def learning_curves(arms: Sequence[Summary]) -> Figure:
    """The paper's figure 2: mean return over the episodes, bands of ± one standard deviation."""
    drawing, (axes,) = figure(TEXT_WIDTH, 2.3)
    for arm, colour, dashes in zip(arms, (BLUE, RED), ("--", "-"), strict=False):
        curve = arm["curve"]
        episode, mean, std = (np.array(curve[name]) for name in ("episode", "mean", "std"))
        axes.fill_between(episode, mean - std, mean + std, color=colour, alpha=0.2, lw=0)
        label = f"ψ = {arm['psi']:g}, ± std across trials"
        axes.plot(episode, mean, color=colour, ls=dashes, label=label)
    axes.axhline(0, color=GREY, lw=0.5, zorder=0)
    axes.set(xlabel="episode", ylabel="discounted return [reward]")
    axes.set_xlim(0, episode[-1] + episode[0])
    axes.legend(loc="lower right", frameon=False)
    return drawing


def sweep(arms: Sequence[Summary]) -> Figure:
    """Return, its spread, and steps on ice, against ψ; bars are 95 % bootstrap intervals."""
    drawing, panels = figure(TEXT_WIDTH, 3.6, rows=3)
    place = np.arange(len(arms))
    rows = (
        ("return_mean", "return\n[reward]", RED, "o"),
        ("return_std_across_trials", "std across\ntrials [reward]", RED, "o"),
        ("frozen_steps_per_episode", "frozen steps\nper episode", BLUE, "s"),
    )
    for axes, (name, label, colour, marker) in zip(panels, rows, strict=True):
        middle = np.array([arm[name] for arm in arms])
        ends = np.array([arm["intervals_95"][name] for arm in arms]).T
        axes.errorbar(
            place, middle, yerr=np.abs(ends - middle), color=colour, marker=marker, ms=3.5,
            capsize=2, lw=1, elinewidth=1,
        )  # fmt: skip
        axes.set_ylabel(label)
        axes.set_xticks(place, [f"{arm['psi']:g}" for arm in arms])
        axes.grid(axis="y", lw=0.3, alpha=0.5)
        axes.set_xlim(-0.3, len(arms) - 0.7)
        if name != "return_mean":
            axes.set_ylim(bottom=0)
    panels[-1].set_xlabel("ψ [1/reward]")
    drawing.align_ylabels(panels)
    return drawing
