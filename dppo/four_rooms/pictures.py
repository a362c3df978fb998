"""All figures of a run, drawn and saved."""

from collections.abc import Iterator, Sequence
from pathlib import Path

from matplotlib.figure import Figure

from dppo.four_rooms import figures, maps
from dppo.four_rooms.experiment import ArmOutcome
from dppo.four_rooms.results import MAIN, Results, optimum_for, typical
from dppo.four_rooms.rollouts import Visits, walk
from dppo.four_rooms.style import DPI, look
from dppo.four_rooms.world import World

_WALKS_FROM = ((1, 1), (5, 5))
"""Row and column of the cells that the trajectories begin in."""


def save_pictures(
    folder: Path,
    world: World,
    outcomes: Sequence[ArmOutcome],
    results: Results,
    tests: dict[str, Visits],
) -> list[str]:
    """Write the figures that the finished arms allow; their names."""
    names = []
    with look():
        for name, drawing in _all(world, outcomes, results, tests):
            drawing.savefig(folder / name, dpi=DPI)
            names.append(name)
    return names


def _all(
    world: World, outcomes: Sequence[ArmOutcome], results: Results, tests: dict[str, Visits]
) -> Iterator[tuple[str, Figure]]:
    yield "map.png", maps.map_figure(world)
    main = [outcome for outcome in outcomes if outcome.arm.key in MAIN]
    if main:
        yield (
            "learning_curves.png",
            figures.learning_curves([arm for arm in results["arms"] if arm["key"] in MAIN]),
        )
        yield (
            "visits.png",
            maps.visits_figure(world, [(_title(arm), tests[arm.arm.key].share) for arm in main]),
        )
        yield (
            "policies.png",
            maps.policies_figure(
                world,
                [
                    panel
                    for arm in main
                    for panel in (
                        (f"learned, {_title(arm)}", arm.policies[typical(arm)]),
                        (f"optimal, {_title(arm)}", optimum_for(world, arm).policy),
                    )
                ],
            ),
        )
        yield (
            "trajectories.png",
            maps.trajectories_figure(
                world,
                [(_title(arm), _walks(world, arm, results["config"]["seed"])) for arm in main],
            ),
        )
    swept = sweep_arms(results)
    if len(swept) > 1:
        yield "sweep.png", figures.sweep(swept)


def _title(outcome: ArmOutcome) -> str:
    return f"ψ = {outcome.arm.agent.psi:g}"


def _walks(world: World, outcome: ArmOutcome, seed: int) -> list[maps.Cells]:
    """One episode of the typical policy from each start."""
    policy = outcome.policies[typical(outcome)]
    return [
        walk(world, policy, start=world.number_of(place), seed=seed, number=number)
        for number, place in enumerate(_WALKS_FROM)
    ]


def sweep_arms(results: Results) -> list[Results]:
    """The arms of the sweep over ψ."""
    return [arm for arm in results["arms"] if arm["title"] == "sweep"]
