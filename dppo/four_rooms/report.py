"""`report.md`: the paper's claims beside what came out."""

from collections.abc import Iterator, Sequence
from typing import Any

from dppo.four_rooms.pictures import sweep_arms
from dppo.four_rooms.results import Results
from dppo.four_rooms.verdicts import claims, of_ablations, of_sweep

_CAPTIONS = {
    "map.png": "The world (paper: figure 1). F pays a random reward with mean 0, G ends the "
    "episode.",
    "learning_curves.png": "Learning curves (figure 2): mean over the trials, ± one standard "
    "deviation across trials, each point the mean of 20 episodes.",
    "visits.png": "Where 80 test episodes of every final policy spend their time (figure 3). "
    "Frozen cells have a red edge.",
    "policies.png": "The likeliest action of each cell (figure 4): the trial with the median "
    "return, and the optimum of eq. 9 that the search finds. What a policy does in cells it no "
    "longer visits was never corrected.",
    "trajectories.png": "One episode of that policy from each of two starts (figure 5), slips and "
    "all. It is the trial with the median return, not one picked to show the claim: with ψ = 0 "
    "too, some trials learn to go around the ice.",
    "sweep.png": "The safe arm with other ψ; bars are 95 % intervals.",
}


def report(results: Results, pictures: Sequence[str]) -> str:
    """The page."""
    return "\n".join(_lines(results, pictures)) + "\n"


def _lines(results: Results, pictures: Sequence[str]) -> Iterator[str]:
    yield "# Safe actor-critic on Four Rooms\n"
    yield _what_ran(results)
    by_key = {arm["key"]: arm for arm in results["arms"]}
    yield "\n## Table 1\n"
    yield from _table([by_key[key] for key in ("plain", "safe") if key in by_key], results)
    yield "\n" + _how_to_read(results)
    if "comparison" in results:
        yield "\n## The paper's claims\n"
        yield "| the paper | here | verdict |\n|---|---|---|"
        yield from (f"| {' | '.join(claim)} |" for claim in claims(results))
    yield "\n## What is best, exactly\n"
    yield from _optimum(results)
    swept = sweep_arms(results)
    if len(swept) > 1:
        yield "\n## Other ψ\n"
        yield from _table(swept, results)
        yield "\n" + of_sweep(swept, results["optimum"])
    others = [
        arm for arm in results["arms"] if arm["key"] not in ("plain", "safe") and arm not in swept
    ]
    if others:
        yield "\n## One thing changed\n"
        yield from _table(others, results)
        yield ""
        yield from (f"- {sentence}" for sentence in of_ablations(by_key))
    yield "\n## Figures\n"
    for name in pictures:
        yield f"![{_CAPTIONS[name]}]({name})\n\n{_CAPTIONS[name]}\n"
    yield _settings(results)


def _what_ran(results: Results) -> str:
    config, seconds = results["config"], sum(results["seconds"].values())
    end = (
        "" if results["status"] == "finished" else " It was stopped; unfinished arms are missing."
    )
    return (
        f"{len(results['arms'])} arms of {config['trials']} trials of {config['episodes']} "
        f"episodes, seed {config['seed']}, in {seconds:.0f} s with {results['jobs']} "
        f"processes.{end} Every number is in `results.json`. Figures describe the last "
        f"{config['last_episodes']} episodes of each trial; brackets are 95 % bootstrap intervals "
        "over trials. The paper prints no numbers for Four Rooms, only figures."
    )


def _table(arms: Sequence[Any], results: Results) -> Iterator[str]:
    yield (
        "| arm | ψ | α_c | discounted return | std across trials | std within a trial "
        "| frozen steps per episode | time-outs | exact V | exact σ |"
    )
    yield "|---|---|---|---|---|---|---|---|---|---|"
    for arm in arms:
        alpha = results["config"]["agents"][arm["key"]]["alpha_critic"]
        cells = (
            arm["key"] if arm["title"] in ("plain", "safe", "sweep") else f"{arm['title']}",
            f"{arm['psi']:g}",
            f"{alpha:g}",
            with_interval(arm, "return_mean"),
            with_interval(arm, "return_std_across_trials"),
            f"{arm['return_std_within']:.1f}",
            with_interval(arm, "frozen_steps_per_episode", 2),
            f"{arm['timeouts_fraction']:.1%}",
            f"{arm['exact_value_mean']:.1f}",
            f"{arm['exact_sigma_mean']:.0f}",
        )
        yield f"| {' | '.join(cells)} |"


def with_interval(summary: Any, name: str, digits: int = 1) -> str:  # noqa: ANN401  JSON
    """`37.2 [35.8, 38.5]`."""
    low, high = summary["intervals_95"][name]
    return f"{summary[name]:.{digits}f} [{low:.{digits}f}, {high:.{digits}f}]"


def _how_to_read(results: Results) -> str:
    return (
        "*Std across trials*: standard deviation over the trials of one episode's return, mean "
        "over the episodes; these are the bands of figure 2. It holds the chance within a policy "
        "and the start cell as well as the differences between trials, so it is close to the *std "
        "within a trial*. *Frozen steps*: steps that end on a frozen cell. *Time-outs*: episodes "
        "that are cut at 500 steps. *Exact V, σ*: by linear equations for the softmax policies "
        "after the last episode, mean over start cells and trials, without the time limit; σ with "
        f"λ = {_agent(results)['lambda_ret']:g} [reward²]."
    )


def _optimum(results: Results) -> Iterator[str]:
    for one in results["optimum"]:
        yield (
            f"- For ψ = {one['psi']:g} the best policy under eq. 9 that the search finds has "
            f"E[V] = {one['exact_value_mean']:.2f} and E[σ] = {one['exact_sigma_mean']:.1f}; from "
            f"{one['cells_onto_ice']:.0f} cells beside the ice it steps onto it. The learned "
            f"policies do so from {one['learned_cells_onto_ice']:.1f} cells on average."
        )


def _agent(results: Results) -> Any:  # noqa: ANN401  JSON
    return next(iter(results["config"]["agents"].values()))


def _settings(results: Results) -> str:
    versions = ", ".join(f"{name} {number}" for name, number in results["versions"].items())
    world, agent = results["config"]["world"], _agent(results)
    shared = ("update", "alpha_theta", "alpha_sigma", "gamma", "lambda_ret", "temperature")
    chosen = ", ".join(f"{name} {agent[name]}" for name in shared)
    rooms = ", ".join(f"{name} {value}" for name, value in world.items())
    return f"## Settings\n\nAgents: {chosen}. World: {rooms}. Versions: {versions}."
