"""What the paper reports: Safe Actor-Critic, Table 2 and figures 6 to 9."""

from dataclasses import dataclass

from dppo.presets import PAPER_PSI


@dataclass(frozen=True, slots=True, kw_only=True)
class Reported:
    """One row of Table 2: mean ± standard deviation across seeds, last 200 training episodes."""

    env: str
    plain: tuple[float, float]
    safe: tuple[float, float]
    seeds: int
    figure: int
    claim_mean: str
    claim_spread: str
    mean_rises: bool
    """The text says that ψ raises the mean."""

    @property
    def psi(self) -> float:
        """ψ of its best policies."""
        return PAPER_PSI[self.env]


TABLE_2 = (
    Reported(
        env="HalfCheetah", plain=(3614.3, 1424), safe=(4256, 1002), seeds=20, figure=6,
        claim_mean="improved mean score",
        claim_spread="significant reduction in the standard deviation",
        mean_rises=True,
    ),
    Reported(
        env="Hopper", plain=(3688.9, 163), safe=(3749.5, 153), seeds=15, figure=8,
        claim_mean="small gain in the mean score",
        claim_spread="small amount of reduction in the standard deviation (the text: significant)",
        mean_rises=True,
    ),
    Reported(
        env="Ant", plain=(808.7, 554), safe=(2342.1, 360), seeds=5, figure=7,
        claim_mean="much better mean performance",
        claim_spread="a reduction in the standard deviation (the text: significant)",
        mean_rises=True,
    ),
    Reported(
        env="Walker2d", plain=(6506.5, 1121), safe=(6191.5, 857), seeds=5, figure=9,
        claim_mean="the mean score drops",
        claim_spread="significant reduction in the standard deviation of the score",
        mean_rises=False,
    ),
)  # fmt: skip


def reported(env: str) -> Reported | None:
    """The paper's row for an environment of any version; variants of it have none."""
    name, _, version = env.partition("-v")
    if not version.isdecimal():
        return None
    return next((row for row in TABLE_2 if row.env == name), None)
