"""Which agents are compared, and what each of them has learned."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dppo.four_rooms.agent import Outcome, Trial
from dppo.four_rooms.mdp import Floats
from dppo.four_rooms.settings import AgentConfig

SWEEP = (0.0, 0.015, 0.05, 0.1, 0.25)
"""ψ of the sweep."""


@dataclass(frozen=True, slots=True)
class Arm:
    """One agent of the comparison; its trials differ in their random numbers only."""

    key: str
    title: str
    agent: AgentConfig


@dataclass(frozen=True, slots=True, kw_only=True)
class ArmOutcome:
    """All trials of one arm, in order. N trials, E episodes."""

    arm: Arm
    policies: Floats  # [N, S, A]
    returns: Floats  # [N, E]  discounted
    lengths: NDArray[np.int16]  # [N, E]
    frozen: NDArray[np.int16]  # [N, E]


def table_1(safe: AgentConfig, plain_alpha_critic: float) -> list[Arm]:
    """The two arms of Table 1. Their α_c differ, as printed."""
    plain = replace(safe, psi=0.0, alpha_critic=plain_alpha_critic)
    return [Arm("plain", "plain", plain), Arm("safe", "safe", safe)]


def psi_sweep(safe: AgentConfig) -> list[Arm]:
    """The safe arm with several ψ, all else equal."""
    return [Arm(f"psi {psi:g}", "sweep", replace(safe, psi=psi)) for psi in SWEEP]


def ablations(safe: AgentConfig, plain_alpha_critic: float) -> list[Arm]:
    """One thing changed in both arms of Table 1; and both with the other's α_c."""
    changes = {
        "printed": ("max Q, min σ as printed", {"update": "printed"}),
        "expected": ("expected SARSA", {"update": "expected"}),
        "baseline": ("state baseline", {"baseline": True}),
        "occupancy": ("γ^t and γ̄^t weights", {"occupancy": True}),
        "inverse temperature": ("1/temperature in ∇ log π", {"inverse_temperature": True}),
    }
    return [
        Arm("plain, equal α_c", "equal α_c", replace(safe, psi=0.0)),
        Arm("safe, equal α_c", "equal α_c", replace(safe, alpha_critic=plain_alpha_critic)),
        *(
            Arm(f"{arm.key}, {name}", title, replace(arm.agent, **change))  # type: ignore[arg-type]
            for name, (title, change) in changes.items()
            for arm in table_1(safe, plain_alpha_critic)
        ),
    ]


def trials_of(arms: Iterable[Arm], trials: int) -> list[Trial]:
    """Every arm's trials, each once. Trial k of every arm draws the same numbers."""
    agents = dict.fromkeys(arm.agent for arm in arms)
    return [Trial(agent, number) for agent in agents for number in range(trials)]


class Collector:
    """Puts finished trials into their arms, in whichever order they come."""

    def __init__(self, arms: Iterable[Arm], trials: int) -> None:
        self._arms, self._trials = list(arms), trials
        self._found: dict[tuple[AgentConfig, int], Outcome] = {}

    def add(self, outcome: Outcome) -> list[Arm]:
        """Keep a finished trial; the arms that it completes."""
        agent = outcome.trial.agent
        self._found[agent, outcome.trial.number] = outcome
        return [arm for arm in self._arms if arm.agent == agent and self._is_complete(arm)]

    def finished(self) -> list[ArmOutcome]:
        """The arms whose trials are all there.

        An arm that lacks trials is left out: the first to finish are those with short episodes.
        """
        return [self._gather(arm) for arm in self._arms if self._is_complete(arm)]

    def _is_complete(self, arm: Arm) -> bool:
        return all((arm.agent, number) in self._found for number in range(self._trials))

    def _gather(self, arm: Arm) -> ArmOutcome:
        found = [self._found[arm.agent, number] for number in range(self._trials)]
        return ArmOutcome(
            arm=arm,
            policies=np.array([outcome.policy for outcome in found]),
            returns=np.array([outcome.returns for outcome in found]),
            lengths=np.array([outcome.lengths for outcome in found]),
            frozen=np.array([outcome.frozen for outcome in found]),
        )
