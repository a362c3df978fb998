"""The settings of the algorithm by topic, with its symbol and unit; frozen and validated.

What can be derived is a property. The strings under the fields are the command line's help texts.
"""

import math
from dataclasses import dataclass
from typing import Literal


def require(holds: bool, name: str, found: object, expected: str) -> None:
    """Raise a ValueError in the words of the command line unless `holds`."""
    if not holds:
        flag = "--" + name.replace("_", "-")
        raise ValueError(f"{flag} is {found}, expected {expected}")


def require_finite(config: object, *names: str) -> None:
    """Raise a ValueError in the words of the command line if one of the fields is not finite."""
    for name in names:
        value = getattr(config, name)
        require(math.isfinite(value), name, value, "a finite number")


@dataclass(frozen=True, slots=True, kw_only=True)
class RolloutConfig:
    """How experience is collected: the paper's W workers are slots."""

    slots: int = 8
    """W: logical workers; they fix data and batch, processes only the speed [count]."""
    num_envs: int = 4
    """E: environments per slot [count]."""
    num_steps: int = 64
    """Steps per environment and iteration; T = E x num_steps per slot [env steps]."""
    window: int = 0
    """K: advantages are cut and bootstrapped every K steps; 0: only at num_steps [env steps]."""
    drop: int = 0
    """D: an update may go on without D late slots, once its deadline is over [count]."""
    drop_limit: int = 8
    """A slot dropped in so many updates in a row is waited for in the next [count]."""
    time_limit: Literal["bootstrap", "time-feature"] = "bootstrap"
    """Past a truncation: bootstrap V and σ, or (paper) observe 0.001 t and count it as an end."""
    normalize_obs: Literal["std", "paper", "off"] = "std"
    """Observations: (o-mean)/std, the paper's (o-mean)/(3 (std+0.1)), or as they are."""
    clip_obs: float = 10.0
    """Bound of normalised observations; inf: none [standard deviations]."""
    reward_scale: Literal["running-std", "one-minus-gamma", "off"] = "running-std"
    """Rewards: divided by the running std of the discounted return, times (1-γ), or raw."""
    exact_envs: bool = True
    """Capture or replay environments at iteration ends; off: cheaper, and not exact on a loss."""

    def __post_init__(self) -> None:
        """Refuse what cannot be run."""
        for name in ("slots", "num_envs", "num_steps", "drop_limit"):
            require(getattr(self, name) >= 1, name, getattr(self, name), ">= 1")
        require(self.slots <= 4096, "slots", self.slots, "<= 4096")
        require(
            0 <= self.drop < self.slots,
            "drop",
            self.drop,
            f"0 <= drop < slots = {self.slots}: an update needs at least one gradient",
        )
        require(self.window >= 0, "window", self.window, ">= 0")
        require(
            self.window == 0 or self.num_steps % self.window == 0,
            "window",
            self.window,
            f"0 or a divisor of num_steps = {self.num_steps}",
        )
        require(self.clip_obs > 0, "clip_obs", self.clip_obs, "> 0")

    @property
    def quorum(self) -> int:
        """W - D: the slots one update waits for, however long it takes."""
        return self.slots - self.drop

    @property
    def samples_per_slot(self) -> int:
        """T: steps of one slot in one iteration."""
        return self.num_envs * self.num_steps

    @property
    def samples(self) -> int:
        """W T: steps of all slots in one iteration."""
        return self.slots * self.samples_per_slot


@dataclass(frozen=True, slots=True, kw_only=True)
class ReturnsConfig:
    """Discounts and traces. One reward scale feeds V, δ and σ."""

    gamma: float = 0.995
    """γ: discount [per env step], 0..1; above gamma_start, that of the run's end."""
    gamma_start: float = 0.99
    """γ at first, if below gamma; 1 - γ goes geometrically to gamma's over the run; -1: gamma."""
    gae_lambda: float = 0.95
    """λ: trace of the generalised advantage, of V and of σ alike [0..1]."""
    lambda_ret: float = -1.0
    """λ of the return whose variance σ is; 1: the full return; -1: same as gae_lambda [0..1]."""
    gamma_bar: Literal["paper", "authors-2019"] = "paper"
    """γ̄, discount of the variance: (γ λ_ret)², or γ λ_ret as in the authors' 2019 code."""
    delta_reward: Literal["scaled", "raw"] = "scaled"
    """Reward in the δ that feeds σ: as for V, or (authors' 2019 code) unscaled."""
    targets: Literal["gae", "monte-carlo"] = "gae"
    """Targets of V and σ: λ-returns, or discounted sums bootstrapped at a cut (eq. 19)."""

    def __post_init__(self) -> None:
        """Refuse what cannot be run."""
        for name in ("gamma", "gae_lambda"):
            require(0 <= getattr(self, name) <= 1, name, getattr(self, name), "0 .. 1")
        for name, other in (("lambda_ret", "gae_lambda"), ("gamma_start", "gamma")):
            value = getattr(self, name)
            expected = f"0 .. 1, or -1 for the same as {other}"
            require(value == -1 or 0 <= value <= 1, name, value, expected)
        if self.gamma_start >= self.gamma:  # nothing grows; one form for what is the same
            object.__setattr__(self, "gamma_start", -1.0)
        if self.gamma_start >= 0:
            require(self.gamma < 1, "gamma", self.gamma, "< 1, or --gamma-start -1")

    @property
    def return_trace(self) -> float:
        """λ_ret: trace of the return whose variance σ is."""
        return self.gae_lambda if self.lambda_ret < 0 else self.lambda_ret

    @property
    def variance_discount(self) -> float:
        """γ̄ = (γ λ_ret)², the discount of the variance recursion (Safe Actor-Critic, eq. 10)."""
        product = self.gamma * self.return_trace
        return product if self.gamma_bar == "authors-2019" else product**2


@dataclass(frozen=True, slots=True, kw_only=True)
class SafetyConfig:
    """The variance penalty."""

    psi: float = 0.0
    """ψ: weight of the variance of the return; 0: plain DPPO [see adv_norm for its unit]."""
    psi_schedule: Literal["constant", "linear", "warmup"] = "constant"
    """ψ over time: constant, linear from 0 to psi, or 0 for psi_warmup and then linear to psi."""
    psi_warmup: float = 0.1
    """Fraction of the run with ψ = 0 in schedule warmup [0..1)."""
    variance_limit: float = math.inf
    """Bound on the mean of σ(s_0); ψ follows by dual steps from psi; inf: none [reward²]."""
    variance_limit_rate: float = 0.05
    """Change of ψ an iteration with new episodes, per unit of relative violation up to 1 [ψ]."""
    adv_norm: Literal["separate", "joint", "none"] = "separate"
    """A_V − ψ A_σ: each standardised [ψ: 1], their sum, or raw [both ψ: 1/scaled reward]."""
    sigma_head: Literal["softplus", "linear"] = "softplus"
    """Output of the variance network: positive by construction, or (paper) linear."""
    reward_variance: float = 0.0
    """κ: learn from r - κ r² + 2 κ r mean(r), the TRVO baseline; 0: from r [1/reward]."""
    variance_critic: bool = True
    """Train the variance network; off only together with psi 0."""

    def __post_init__(self) -> None:
        """Refuse what cannot be run."""
        require_finite(self, "psi", "variance_limit_rate", "reward_variance")
        for name in ("psi", "reward_variance"):
            require(getattr(self, name) >= 0, name, getattr(self, name), ">= 0")
        require(0 <= self.psi_warmup < 1, "psi_warmup", self.psi_warmup, "0 <= psi_warmup < 1")
        for name in ("variance_limit", "variance_limit_rate"):
            require(getattr(self, name) > 0, name, getattr(self, name), "> 0")
        needs_critic = self.psi > 0 or math.isfinite(self.variance_limit)
        require(
            self.variance_critic or not needs_critic,
            "variance_critic",
            self.variance_critic,
            "on, because psi or variance_limit needs sigma",
        )
        require(
            math.isinf(self.variance_limit) or self.psi_schedule == "constant",
            "psi_schedule",
            self.psi_schedule,
            "constant, because variance_limit moves psi by itself",
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class UpdateConfig:
    """The updates of one iteration: M of the policy, B of the critics."""

    learning_rate: float = 1e-3
    """α_θ: Adam learning rate of the policy [1 per update]."""
    critic_learning_rate: float = 2e-3
    """α_c: Adam learning rate of V and σ [1 per update]."""
    lr_schedule: Literal["linear", "constant", "servo"] = "linear"
    """Both learning rates: linear to 0, constant, or (paper) the policy's follows β."""
    update_epochs: int = 5
    """Passes over the iteration's data; M = update_epochs x num_minibatches [count]."""
    num_minibatches: int = 2
    """Slices of every slot's samples, one per update; 1: full batch [count]."""
    critic_epochs: int = 0
    """Passes for V and σ; 0: as update_epochs [count]."""
    critic_minibatches: int = 0
    """Slices for V and σ; 0: as num_minibatches [count]."""
    critic_replay: bool = False
    """(paper) V and σ also fit the previous iteration's samples."""
    max_grad_norm: float = 0.5
    """Largest norm of each network's averaged gradient [L2]; inf: no bound."""
    adam_eps: float = 1e-5
    """ε: of Adam [gradient]."""

    def __post_init__(self) -> None:
        """Refuse what cannot be run."""
        require_finite(self, "learning_rate", "critic_learning_rate", "adam_eps")
        for name in ("learning_rate", "critic_learning_rate", "max_grad_norm", "adam_eps"):
            require(getattr(self, name) > 0, name, getattr(self, name), "> 0")
        for name in ("update_epochs", "num_minibatches"):
            require(getattr(self, name) >= 1, name, getattr(self, name), ">= 1")
        for name in ("critic_epochs", "critic_minibatches"):
            require(getattr(self, name) >= 0, name, getattr(self, name), ">= 0")

    @property
    def policy_updates(self) -> int:
        """M: policy updates per iteration."""
        return self.update_epochs * self.num_minibatches

    @property
    def critic_slices(self) -> int:
        """Minibatches per pass of the critics."""
        return self.critic_minibatches or self.num_minibatches

    @property
    def critic_updates(self) -> int:
        """B: updates of V and of σ per iteration."""
        return (self.critic_epochs or self.update_epochs) * self.critic_slices

    @property
    def updates(self) -> int:
        """Rounds per iteration: policy and critics share them."""
        return max(self.policy_updates, self.critic_updates)


@dataclass(frozen=True, slots=True, kw_only=True)
class KlConfig:
    """The trust region: adaptive penalty, hinge, early stop."""

    kl_target: float = 0.02
    """KL_target: wanted KL[π_old‖π] per iteration [nats per state]."""
    kl_coef: float = 1.0
    """β at the start: weight of the KL penalty [1/nat]."""
    kl_coef_scale: float = 1.5
    """α: factor by which β moves [> 1]."""
    kl_low: float = 0.5
    """β_low: β shrinks below β_low KL_target [1]."""
    kl_high: float = 2.0
    """β_high: β grows above β_high KL_target [1]."""
    kl_coef_min: float = 1 / 35
    """Lower clamp of β [1/nat]."""
    kl_coef_max: float = 35.0
    """Upper clamp of β [1/nat]."""
    hinge_coef: float = 50.0
    """ξ: weight of max(0, KL - 2 KL_target)² [1/nat²]."""
    kl_stop: float = 4.0
    """Policy updates of the iteration stop above kl_stop x KL_target; inf: never [1]."""
    kl_scope: Literal["chief", "worker"] = "chief"
    """Who decides stop and β: the chief on the mean KL, or (Heess) each slot on its own."""

    def __post_init__(self) -> None:
        """Refuse what cannot be run."""
        require_finite(self, "kl_target", "kl_coef", "hinge_coef")
        require(self.kl_target > 0, "kl_target", self.kl_target, "> 0")
        require(self.kl_coef_scale > 1, "kl_coef_scale", self.kl_coef_scale, "> 1")
        require(self.hinge_coef >= 0, "hinge_coef", self.hinge_coef, ">= 0")
        require(self.kl_stop > 0, "kl_stop", self.kl_stop, "> 0")
        require(0 < self.kl_low < self.kl_high, "kl_low", self.kl_low, "0 < kl_low < kl_high")
        require(
            0 < self.kl_coef_min <= self.kl_coef <= self.kl_coef_max,
            "kl_coef",
            self.kl_coef,
            f"kl_coef_min {self.kl_coef_min:g} .. kl_coef_max {self.kl_coef_max:g}",
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class NetworkConfig:
    """Separate tanh networks for policy, value and variance."""

    hidden_sizes: tuple[int, ...] = (64, 64)
    """Hidden units of each layer [count]; ignored in architecture paper."""
    architecture: Literal["mlp", "paper"] = "mlp"
    """Sizes: hidden_sizes, or (paper) 10 O, geometric mean, 10 A (5 for the critics)."""
    init: Literal["orthogonal", "fan-in"] = "orthogonal"
    """Weights: orthogonal with a small last policy layer, or (paper) N(0, 1/fan_in)."""
    log_std_init: float = -1.0
    """Initial log of the Gaussian policy's std, per action dimension [nats]."""
    log_std_rate: float = 1.0
    """Learning-rate factor of log std [1]; -1: (paper) half of (10 x last hidden size) // 48."""

    def __post_init__(self) -> None:
        """Refuse what cannot be run."""
        require_finite(self, "log_std_init")
        fits = len(self.hidden_sizes) >= 1 and min(self.hidden_sizes) >= 1
        require(fits, "hidden_sizes", self.hidden_sizes, "one or more sizes >= 1")
        require(
            0 < self.log_std_rate < math.inf or self.log_std_rate == -1,
            "log_std_rate",
            self.log_std_rate,
            "> 0, or -1 for the paper's",
        )
