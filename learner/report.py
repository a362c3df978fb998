"""Facts that an iteration yields: frozen figures for logs, console and files."""

from dataclasses import dataclass, field

from dppo.config import Config
from dppo.gradients import Sums
from dppo.moments import merged
from dppo.networks import Network
from dppo.schedules import in_iteration
from dppo.statistics import cvar
from dppo.wire.messages import Collected
from learner.state import State


@dataclass(slots=True)
class Training:
    """Figures of one iteration's updates while they are made."""

    psi: float
    beta: float
    advantage_stds: tuple[float, float, float]
    """Standard deviations of A_V, A_σ and A_V − ψ A_σ, before standardising."""
    kls: list[tuple[float, float]] = field(default_factory=list)
    """Sum of KL[π_old‖π] after the last update, and samples, of each slot in order [nats]."""
    std: float | None = None
    """Mean standard deviation of actions after the updates; None: actions are choices."""
    dropped: int = 0
    policy_updates: int = 0
    sums: list[Sums] = field(default_factory=list)
    norms: dict[Network, float] = field(default_factory=dict)

    @property
    def kl(self) -> float:
        """Mean KL[π_old‖π] after the last update [nats]; 0 without updates."""
        weight = sum(weight for _, weight in self.kls)
        return sum(kl for kl, _ in self.kls) / weight if weight else 0.0

    def note(self, sums: Sums, stop: bool) -> None:
        """One update's sums; `stop`: its policy gradient is not applied."""
        self.sums.append(sums)
        self.policy_updates += int(sums.policy_weight > 0 and not stop)

    def note_norm(self, name: Network, norm: float) -> None:
        """Norm of a network's averaged gradient before clipping; the last one stays."""
        self.norms[name] = norm

    def mean(self, name: str, weight: str) -> float:
        """Weighted mean of a sum over the iteration's updates; 0 without any."""
        total = sum(getattr(sums, weight) for sums in self.sums)
        return sum(getattr(sums, name) for sums in self.sums) / total if total else 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class IterationReport:
    """One finished iteration. `metrics` are a pure function of config and seed, but cluster/."""

    iteration: int
    """Iterations finished."""
    env_steps: int
    """Environment steps of all slots so far."""
    metrics: dict[str, float]
    """Name (as SB3 and CleanRL call it) to value."""
    episodes: tuple[tuple[float, float], ...] = ()
    """Return and length of those that ended in the iteration, in slot order."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Finished:
    """An iteration between two states; its report is made when there is time."""

    before: State
    after: State
    collected: list[Collected]
    """In slot order."""
    training: Training
    config: Config
    num_workers: int

    def report(self) -> IterationReport:
        """Its figures."""
        training, episodes = self.training, self.after.episodes
        config = in_iteration(self.config, self.before.iteration)
        fit = merged([answer.fit for answer in self.collected])
        starts = merged([answer.start_sigma for answer in self.collected])
        spread = fit.m2 / max(fit.count, 1.0)
        metrics = {
            "train/kl": training.kl,
            "train/kl_coef": self.after.beta,
            "train/policy_updates": float(training.policy_updates),
            "train/policy_loss": -training.mean("objective", "policy_weight"),
            "train/value_loss": training.mean("value_loss", "critic_weight"),
            "train/variance_loss": training.mean("variance_loss", "critic_weight"),
            "train/explained_variance": float(1 - spread[1] / spread[0]) if spread[0] > 0 else 0.0,
            "train/reward_scale": self.before.statistics.reward_scale(config),
            "train/gamma": config.returns.gamma,
            "safety/psi": training.psi,
            "safety/sigma_mean": float(fit.mean[2]),
            "safety/adv_v_std": training.advantage_stds[0],
            "safety/adv_sigma_std": training.advantage_stds[1],
            "cluster/workers": float(self.num_workers),
            "cluster/dropped": float(training.dropped),
        }
        if training.std is not None:
            metrics["train/std"] = training.std
        if starts.count > 0:
            metrics["safety/start_sigma"] = float(starts.mean[0])
        metrics |= {f"train/{name}_grad_norm": norm for name, norm in training.norms.items()}
        if len(episodes):
            returns, lengths = episodes.T
            metrics |= {
                "rollout/ep_rew_mean": float(returns.mean()),
                "rollout/ep_len_mean": float(lengths.mean()),
                "charts/episodic_return": float(returns[-1]),
                "safety/return_std": float(returns.std()),
                "safety/cvar10": cvar(returns),
            }
        return IterationReport(
            iteration=self.after.iteration,
            env_steps=self.config.env_steps(self.after.iteration),
            metrics=metrics,
            episodes=tuple(
                (float(episode[0]), float(episode[1]))
                for answer in self.collected
                for episode in answer.episodes.reshape(-1, 2)
            ),
        )
