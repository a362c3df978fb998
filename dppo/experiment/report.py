"""The report: results.json, curves.csv, pictures, report.md and report.html."""

import csv
import io
import itertools
import json
import math
import shlex
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path

from dppo.experiment import how_to_read
from dppo.experiment.folder import Folder, Plan
from dppo.experiment.in_short import goal_sentence, in_short
from dppo.experiment.measure import Cell, curve_of
from dppo.experiment.page import (
    Block,
    Bullets,
    Code,
    Heading,
    Paragraph,
    Picture,
    to_html,
    to_markdown,
)
from dppo.experiment.policy_tables import (
    best_seeds,
    calibration_sentence,
    calibrations,
    within_policies,
)
from dppo.experiment.results import Results, describe
from dppo.experiment.tables import (
    all_arms,
    arms_of,
    beside_the_paper,
    claims_table,
    every_seed,
    moved_psi,
    on_the_way,
    over_environments,
)

_MANY = 30


def write_report(folder: Folder, plan: Plan) -> Path:
    """Everything that can be said of the runs that have finished; the page's path."""
    from dppo.experiment.figures import save_figures

    results, cells = describe(folder, plan)
    folder.write("results.json", json.dumps(results, indent=1) + "\n")
    folder.write("curves.csv", _curves(cells))
    blocks = list(_blocks(results, save_figures(folder.path, cells)))
    folder.write("report.md", to_markdown(blocks))
    folder.write("report.html", to_html(blocks, folder.path))
    return folder.path / "report.md"


def _curves(cells: Sequence[Cell]) -> str:
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(["env", "arm", "psi", "seeds", "env_steps", "return_mean", "return_std"])
    for cell in cells:
        curve = curve_of(cell)
        if curve is None:
            continue
        for steps, mean, std in zip(*(curve[name] for name in curve), strict=True):
            psi = "" if cell.runs[0].moves_psi else f"{cell.psi:g}"
            row = [cell.env, cell.arm, psi, len(cell.finished)]
            spread = "" if math.isnan(std) else f"{std:.6g}"
            table.writerow([*row, f"{steps:.0f}", f"{mean:.6g}", spread])
    return text.getvalue()


def _blocks(results: Results, pictures: Sequence[tuple[str, str]]) -> Iterator[Block]:
    yield Heading(results["title"], 1)
    yield from _what_ran(results)
    if (table := in_short(results)) is not None:
        yield Heading("In short")
        yield table
        yield Paragraph(f"{goal_sentence(results)} {how_to_read.IN_SHORT}".strip())
    if (table := beside_the_paper(results)) is not None:
        yield Heading("Table 2: the paper's numbers and ours")
        yield table
        yield Paragraph(
            "Mean ± standard deviation across seeds of the mean return of the last 200 training "
            "episodes. The paper prints only the best ψ; all that were run here are below."
        )
        yield Heading("The paper's claims")
        table = claims_table(results)
        yield table
        yield Paragraph(how_to_read.claims(results, [claim for claim, *_ in table.rows]))
    yield Heading("Every arm: training returns")
    yield all_arms(results)
    yield Paragraph(how_to_read.training(results))
    if (table := moved_psi(results)) is not None:
        yield Heading("Where ψ moves")
        yield table
    if (table := every_seed(results)) is not None:
        yield Heading("Every seed: mean return of the last 100 training episodes")
        yield table
    if (table := on_the_way(results)) is not None:
        yield Heading("On the way: mean return of the last 100 training episodes")
        yield table
    if (table := over_environments(results)) is not None:
        yield Heading("Over all environments")
        yield table
        yield Paragraph(how_to_read.TOGETHER)
    yield from _evaluation(results)
    if pictures:
        yield Heading("Figures")
        yield from (Picture(name, caption) for name, caption in pictures)
    yield from _settings(results)


def _what_ran(results: Results) -> Iterator[Block]:
    runs, arms = results["runs"], [arm for _, _, arm in arms_of(results)]
    steps = sorted({arm["steps"] for arm in arms})
    seeds = sorted({len(arm["seeds_planned"]) for arm in arms})
    yield Paragraph(
        f"{runs['finished']} of {runs['planned']} runs have finished: "
        f"{_count(results['environments'], 'environment')}, {_numbers(seeds)} "
        f"{'seed' if seeds == [1] else 'seeds'} an arm, "
        f"{_numbers(steps)} environment steps a run. The numbers are in `results.json`; the "
        "curves are in `curves.csv`."
    )
    if results["status"] == "partial":
        missing = runs["missing"]
        more = f" and {len(missing) - _MANY} more" if len(missing) > _MANY else ""
        names = ", ".join(missing[:_MANY])
        yield Paragraph(
            "**This is a partial grid: all judgements are interim.** What follows is of the "
            "finished runs alone, and arms may have different seeds."
            + (f" Missing: {names}{more}." if missing else "")
        )
    if runs["not_evaluated"]:
        names = ", ".join(runs["not_evaluated"])
        yield Paragraph(f"Trained, and not evaluated yet: {names}.")
    if runs["without_episodes"]:
        names = ", ".join(runs["without_episodes"])
        yield Paragraph(f"Left out, since no training episode has finished: {names}.")
    if runs["failed"]:
        yield Paragraph("**Failed runs**, so that arms may have different seeds:")
        yield Bullets([f"{name}: {reason}" for name, reason in runs["failed"].items()])
    inexact = [arm["label"] for arm in arms if arm["seeds"] and not arm["exact"]]
    if inexact:
        yield Paragraph(f"Not exact (`exact: false` in result.json): {', '.join(inexact)}.")


def _evaluation(results: Results) -> Iterator[Block]:
    any_table = False
    for start, whence in (("free", "free start states"), ("fixed", "one fixed start state")):
        for kind, what in (("undiscounted", "returns"), ("discounted", "discounted returns")):
            if (table := within_policies(results, start, kind)) is not None:
                any_table = True
                yield Heading(f"Within a policy: {what} from {whence}")
                yield table
    if any_table:
        yield Paragraph(how_to_read.POLICIES)
    if (table := calibrations(results)) is not None:
        yield Heading("Does σ know how far returns spread?")
        yield table
        yield Paragraph(f"{calibration_sentence(results)} {how_to_read.SIGMA}")
    if (table := best_seeds(results)) is not None:
        yield Heading("The best seed of each arm")
        yield table
        yield Paragraph(how_to_read.best_seeds(results))


def _settings(results: Results) -> Iterator[Block]:
    yield Heading("What was run")
    lines = []
    for env, one in results["environments"].items():
        for key, arm in one["arms"].items():
            seed = arm["seeds_planned"][0]
            run = next(
                words
                for name, words in results["commands"].items()
                if _is_of(words, env, seed) and f"__{key}__" in name
            )
            lines.append(shlex.join(run))
    yield Paragraph("The first seed of each arm; the others differ in `--seed` only.")
    yield Code(lines)
    if results["run_otherwise"]:
        yield Paragraph(
            "**These commands do not give these runs again:** the settings they had are in each "
            "run's `config.json`."
        )
        runs = results["run_otherwise"].items()
        yield Bullets([f"{name}: {', '.join(differences)}" for name, differences in runs])
    yield Paragraph("The experiment was started as:")
    sessions = results["sessions"]
    yield Code([f"{one['command']}  # {one['time']}, {one['jobs']} jobs" for one in sessions])
    machines = dict.fromkeys(
        f"{one['processor']}, {one['cores']} cores, {one['system']}" for one in sessions
    )
    versions = results["versions"]
    of_runs = ", ".join(
        f"{name} {' and '.join(numbers)}" for name, numbers in versions["runs"].items()
    )
    of_report = ", ".join(
        f"{name} {number or 'missing'}" for name, number in versions["report"].items()
    )
    yield Paragraph(f"Machine: {'; '.join(machines)}.")
    yield Paragraph(f"Versions of the runs: {of_runs or 'none'}. Of this report: {of_report}.")


def _is_of(words: Sequence[str], env: str, seed: int) -> bool:
    pairs = list(itertools.pairwise(words))
    return ("--env", env) in pairs and ("--seed", str(seed)) in pairs


def _count(things: Collection[object], name: str) -> str:
    return f"{len(things)} {name}{'' if len(things) == 1 else 's'}"


def _numbers(values: Sequence[int]) -> str:
    return " or ".join(f"{value:,}" for value in values)
