"""All figures of a run, drawn and saved."""

from collections.abc import Iterator
from io import BytesIO
from pathlib import Path

from matplotlib.figure import Figure

from dppo.files import replace_durably
from dppo.four_rooms import figures, maps
from dppo.four_rooms.mdp import Floats
from dppo.four_rooms.results import MAIN, Findings, Results, typical
from dppo.four_rooms.rollouts import walk
from dppo.four_rooms.style import DPI, look

_WALKS_FROM = ((1, 1), (5, 5))
"""Row and column of the cells that the trajectories begin in."""


def save_pictures(folder: Path, findings: Findings, results: Results) -> list[str]:
    """Write the figures that the finished arms allow; their names."""
    names = []
    with look():
        for name, drawing in _all(findings, results):
            picture = BytesIO()
            drawing.savefig(picture, format="png", dpi=DPI)
            replace_durably(folder / name, picture.getvalue())
            names.append(name)
    return names


def _all(findings: Findings, results: Results) -> Iterator[tuple[str, Figure]]:
    world = findings.world
    yield "map.png", maps.map_figure(world)
    if findings.main:
        curves = [arm for arm in results["arms"] if arm["key"] in MAIN]
        shares, policies, walks = [], [], []
        for arm in findings.main:
            title, key = f"ψ = {arm.arm.agent.psi:g}", arm.arm.key
            policy = arm.policies[typical(arm)]
            shares.append((title, findings.tests[key].share))
            policies.append((f"learned, {title}", policy))
            policies.append((f"optimal, {title}", findings.optima[key].policy))
            walks.append((title, _walks(findings, policy)))
        yield "learning_curves.png", figures.learning_curves(curves)
        yield "visits.png", maps.visits_figure(world, shares)
        yield "policies.png", maps.policies_figure(world, policies)
        yield "trajectories.png", maps.trajectories_figure(world, walks)
    if sweep_arms(results):
        yield "sweep.png", figures.sweep(sweep_arms(results))


def _walks(findings: Findings, policy: Floats) -> list[maps.Cells]:
    """One episode of the policy from each start."""
    world, seed = findings.world, findings.seed
    return [
        walk(world, policy, start=world.number_of(place), seed=seed, number=number)
        for number, place in enumerate(_WALKS_FROM)
    ]


def sweep_arms(results: Results) -> list[Results]:
    """The arms of the sweep over ψ."""
    return [arm for arm in results["arms"] if arm["title"] == "sweep"]
