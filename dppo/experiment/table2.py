"""The built-in grid: the paper's Table 2."""

from collections.abc import Iterator, Sequence

from dppo.errors import UsageError
from dppo.experiment.paper import TABLE_2, reported
from dppo.experiment.plan import Grid, Run
from dppo.experiment.settings import Settings

ENVIRONMENTS = tuple(f"{row.env}-v4" for row in TABLE_2)
"""Closest to the paper's."""
BASELINE = "psi0"


def table2(
    *,
    envs: Sequence[str],
    psis: Sequence[float],
    seeds: int,
    steps: int,
    evaluate: int,
    settings: Settings,
) -> Grid:
    """ψ = 0 against others; without `psis` the paper's of each environment, and twice that.

    Raises:
        UsageError: no grid that can be run.
    """
    if "psi" in settings:
        raise UsageError("found --psi after --; give --psis 0 0.1 before --")
    runs = [
        Run.build(
            env=env, arm=arm, seed=seed, steps=steps, settings={**settings, "psi": float(psi)}
        )
        for env in envs
        for arm, psi in (_given(psis) if psis else _of_paper(env))
        for seed in range(1, seeds + 1)
    ]
    return Grid(title="Table 2", runs=tuple(runs), baseline=BASELINE, evaluate=evaluate)


def _given(psis: Sequence[float]) -> Iterator[tuple[str, float]]:
    return ((f"psi{psi:g}", psi) for psi in psis)


def _of_paper(env: str) -> Iterator[tuple[str, float]]:
    row = reported(env)
    if row is None:
        known = ", ".join(one.env for one in TABLE_2)
        raise UsageError(
            f"--envs has {env}, of which the paper names no psi; add --psis, such as --psis 0 "
            f"0.1, or take {known} of some version"
        )
    return iter((("psi0", 0.0), ("psi-paper", row.psi), ("psi-twice", 2 * row.psi)))
