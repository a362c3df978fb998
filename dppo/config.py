"""Every setting of a run, with its symbol and unit; frozen, validated, free of derived fields.

The learner decides these and sends them to every worker, so two processes cannot disagree. What
belongs to one process alone (addresses, folders, how many local workers) stands in that process's
own `__main__`. Help texts are the strings under the fields.
"""

import dataclasses
import json
import math
from dataclasses import dataclass, field
from typing import Any, Literal, Self


def _require(holds: bool, name: str, found: object, expected: str) -> None:
    if not holds:
        flag = "--" + name.replace("_", "-")
        raise ValueError(f"{flag} is {found}, expected {expected}")


def _require_finite(config: object, *names: str) -> None:
    for name in names:
        value = getattr(config, name)
        _require(math.isfinite(value), name, value, "a finite number")


@dataclass(frozen=True, slots=True, kw_only=True)
class RunConfig:
    """What is trained, on what, for how long."""

    env: str = "Ant-v4"
    """Gymnasium environment id (--env-id works too)."""
    env_kwargs: str = "{}"
    """Keyword arguments of the environment, as JSON, e.g. '{"ctrl_cost_weight": 0.1}'."""
    seed: int = 0
    """Seed of every random stream; same seed and settings, same bits."""
    total_timesteps: int = 1_000_000
    """Environment steps of all slots together; accepts 1e6; rounded up to whole iterations."""

    def __post_init__(self) -> None:
        """Refuse what cannot be run."""
        _require(0 <= self.seed < 2**63, "seed", self.seed, "0 <= seed < 2**63")
        _require(self.total_timesteps >= 1, "total_timesteps", self.total_timesteps, ">= 1")
        try:
            is_object = isinstance(json.loads(self.env_kwargs), dict)
        except json.JSONDecodeError:
            is_object = False
        _require(is_object, "env_kwargs", repr(self.env_kwargs), 'a JSON object such as {"a": 1}')


@dataclass(frozen=True, slots=True, kw_only=True)
class RolloutConfig:
    """How experience is collected: the paper's W workers are slots."""

    slots: int = 8
    """W: logical workers; they fix data and batch, processes only the speed [count]."""
    num_envs: int = 2
    """E: environments per slot [count]."""
    num_steps: int = 256
    """Steps per environment and iteration; T = E x num_steps per slot [env steps]."""
    window: int = 0
    """K: advantages are cut and bootstrapped every K steps; 0: only at num_steps [env steps]."""
    drop: int = 0
    """D: an update proceeds once W - D slots are in; late ones are never applied [count]."""
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
        for name in ("slots", "num_envs", "num_steps"):
            _require(getattr(self, name) >= 1, name, getattr(self, name), ">= 1")
        _require(self.slots <= 4096, "slots", self.slots, "<= 4096")
        _require(
            0 <= self.drop < self.slots, "drop", self.drop,
            f"0 <= drop < slots = {self.slots}: an update needs at least one gradient",
        )  # fmt: skip
        _require(self.window >= 0, "window", self.window, ">= 0")
        _require(
            self.window == 0 or self.num_steps % self.window == 0, "window", self.window,
            f"0 or a divisor of num_steps = {self.num_steps}",
        )  # fmt: skip
        _require(self.clip_obs > 0, "clip_obs", self.clip_obs, "> 0")

    @property
    def quorum(self) -> int:
        """W - D: the slots one update waits for."""
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

    gamma: float = 0.99
    """γ: discount [per env step], 0..1."""
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
            _require(0 <= getattr(self, name) <= 1, name, getattr(self, name), "0 .. 1")
        _require(
            self.lambda_ret == -1 or 0 <= self.lambda_ret <= 1, "lambda_ret", self.lambda_ret,
            "0 .. 1, or -1 for the same as gae_lambda",
        )  # fmt: skip

    @property
    def variance_discount(self) -> float:
        """γ̄ = (γ λ_ret)², the discount of the variance recursion (Safe Actor-Critic, eq. 10)."""
        trace = self.gae_lambda if self.lambda_ret < 0 else self.lambda_ret
        product = self.gamma * trace
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
    """Size of a dual step, per iteration and unit of relative violation."""
    adv_norm: Literal["separate", "joint", "none"] = "separate"
    """How A_V and A_σ meet: each standardised (unit of ψ: 1), their sum (1/reward), or raw."""
    sigma_head: Literal["softplus", "linear"] = "softplus"
    """Output of the variance network: positive by construction, or (paper) linear."""
    variance_critic: bool = True
    """Train the variance network; off only together with psi 0."""

    def __post_init__(self) -> None:
        """Refuse what cannot be run."""
        _require_finite(self, "psi", "variance_limit_rate")
        _require(self.psi >= 0, "psi", self.psi, ">= 0")
        _require(0 <= self.psi_warmup < 1, "psi_warmup", self.psi_warmup, "0 <= psi_warmup < 1")
        _require(self.variance_limit > 0, "variance_limit", self.variance_limit, "> 0")
        needs_critic = self.psi > 0 or math.isfinite(self.variance_limit)
        _require(
            self.variance_critic or not needs_critic, "variance_critic", self.variance_critic,
            "on, because psi or variance_limit needs sigma",
        )  # fmt: skip
        _require(
            math.isinf(self.variance_limit) or self.psi_schedule == "constant", "psi_schedule",
            self.psi_schedule, "constant, because variance_limit moves psi by itself",
        )  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class UpdateConfig:
    """The updates of one iteration: M of the policy, B of the critics."""

    learning_rate: float = 3e-4
    """Adam step size of the policy."""
    critic_learning_rate: float = 1e-3
    """Adam step size of the value and the variance network."""
    lr_schedule: Literal["linear", "constant", "servo"] = "linear"
    """Both step sizes: linear to 0, constant, or (paper) the policy's follows β at its bounds."""
    update_epochs: int = 10
    """Passes over the iteration's data; M = update_epochs x num_minibatches [count]."""
    num_minibatches: int = 8
    """Slices of every slot's samples, one per update; 1: full batch [count]."""
    critic_epochs: int = 0
    """Passes for V and σ; 0: as update_epochs [count]."""
    critic_minibatches: int = 0
    """Slices for V and σ; 0: as num_minibatches [count]."""
    critic_replay: bool = False
    """(paper) V and σ also fit the previous iteration's samples."""
    max_grad_norm: float = 0.5
    """Largest norm of each network's averaged gradient; inf: no bound."""
    adam_eps: float = 1e-5
    """ε of Adam."""

    def __post_init__(self) -> None:
        """Refuse what cannot be run."""
        _require_finite(self, "learning_rate", "critic_learning_rate", "adam_eps")
        for name in ("learning_rate", "critic_learning_rate", "max_grad_norm", "adam_eps"):
            _require(getattr(self, name) > 0, name, getattr(self, name), "> 0")
        for name in ("update_epochs", "num_minibatches"):
            _require(getattr(self, name) >= 1, name, getattr(self, name), ">= 1")
        for name in ("critic_epochs", "critic_minibatches"):
            _require(getattr(self, name) >= 0, name, getattr(self, name), ">= 0")

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

    kl_target: float = 0.01
    """KL_target: wanted KL[π_old‖π] per iteration [nats per state]."""
    kl_coef: float = 1.0
    """β at the start: weight of the KL penalty."""
    kl_coef_scale: float = 1.5
    """α: factor by which β moves [> 1]."""
    kl_low: float = 0.5
    """β_low: β shrinks below β_low KL_target."""
    kl_high: float = 2.0
    """β_high: β grows above β_high KL_target."""
    kl_coef_min: float = 1 / 35
    """Lower clamp of β."""
    kl_coef_max: float = 35.0
    """Upper clamp of β."""
    hinge_coef: float = 50.0
    """ξ: weight of max(0, KL - 2 KL_target)²."""
    kl_stop: float = 4.0
    """Policy updates of the iteration stop above kl_stop x KL_target; inf: never."""
    kl_scope: Literal["chief", "worker"] = "chief"
    """Who decides stop and β: the chief on the mean KL, or (Heess) each slot on its own."""

    def __post_init__(self) -> None:
        """Refuse what cannot be run."""
        _require_finite(self, "kl_target", "kl_coef", "hinge_coef")
        _require(self.kl_target > 0, "kl_target", self.kl_target, "> 0")
        _require(self.kl_coef_scale > 1, "kl_coef_scale", self.kl_coef_scale, "> 1")
        _require(self.hinge_coef >= 0, "hinge_coef", self.hinge_coef, ">= 0")
        _require(self.kl_stop > 0, "kl_stop", self.kl_stop, "> 0")
        _require(0 < self.kl_low < self.kl_high, "kl_low", self.kl_low, "0 < kl_low < kl_high")
        _require(
            0 < self.kl_coef_min <= self.kl_coef <= self.kl_coef_max, "kl_coef", self.kl_coef,
            f"kl_coef_min {self.kl_coef_min:g} .. kl_coef_max {self.kl_coef_max:g}",
        )  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class NetworkConfig:
    """Separate tanh networks for policy, value and variance."""

    hidden_sizes: tuple[int, ...] = (64, 64)
    """Hidden units per layer; ignored in architecture paper."""
    architecture: Literal["mlp", "paper"] = "mlp"
    """Sizes: hidden_sizes, or (paper) 10 O, geometric mean, 10 A (5 for the critics)."""
    init: Literal["orthogonal", "fan-in"] = "orthogonal"
    """Weights: orthogonal with a small last policy layer, or (paper) N(0, 1/fan_in)."""
    log_std_init: float = -0.5
    """Initial log of the Gaussian policy's std, per action dimension [nats]."""
    log_std_rate: float = 1.0
    """Learning-rate factor of log std; -1: (paper) (10 h3) // 48."""

    def __post_init__(self) -> None:
        """Refuse what cannot be run."""
        _require_finite(self, "log_std_init")
        fits = len(self.hidden_sizes) >= 1 and min(self.hidden_sizes) >= 1
        _require(fits, "hidden_sizes", self.hidden_sizes, "one or more sizes >= 1")
        _require(
            self.log_std_rate > 0 or self.log_std_rate == -1, "log_std_rate", self.log_std_rate,
            "> 0, or -1 for the paper's",
        )  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class Config:
    """One run. Equal configs and seeds give equal parameters, bit for bit (with drop 0)."""

    run: RunConfig = field(default_factory=RunConfig)
    rollout: RolloutConfig = field(default_factory=RolloutConfig)
    returns: ReturnsConfig = field(default_factory=ReturnsConfig)
    safety: SafetyConfig = field(default_factory=SafetyConfig)
    update: UpdateConfig = field(default_factory=UpdateConfig)
    kl: KlConfig = field(default_factory=KlConfig)
    network: NetworkConfig = field(default_factory=NetworkConfig)

    def __post_init__(self) -> None:
        """Refuse what only shows across groups."""
        samples = self.rollout.samples_per_slot
        for name, slices in (
            ("num_minibatches", self.update.num_minibatches),
            ("critic_minibatches", self.update.critic_slices),
        ):
            _require(
                samples % slices == 0, name, slices,
                f"a divisor of the {samples} samples of a slot (num_envs x num_steps)",
            )  # fmt: skip

    @property
    def iterations(self) -> int:
        """N: iterations of the run, total_timesteps rounded up."""
        return -(-self.run.total_timesteps // self.rollout.samples)

    def to_dict(self) -> dict[str, dict[str, Any]]:
        """Nested plain values, for JSON. Infinity becomes the string "inf"."""
        return {
            group: {name: _plain(value) for name, value in fields.items()}
            for group, fields in dataclasses.asdict(self).items()
        }

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> Self:
        """The inverse of `to_dict`; missing fields take their defaults.

        Raises:
            ValueError: a group, a field or a value that does not belong, named.
        """
        groups = {}
        known_groups = {group.name: group for group in dataclasses.fields(cls)}
        for name, fields in values.items():
            if name not in known_groups or not isinstance(fields, dict):
                raise ValueError(
                    f"found the group {name!r}, expected tables named {', '.join(known_groups)}"
                )
            group_type = type(getattr(cls(), name))
            groups[name] = group_type(**_fields(group_type, fields))
        return cls(**groups)


def _plain(value: Any) -> Any:  # noqa: ANN401  any field value, to any JSON value
    if isinstance(value, tuple):
        return list(value)
    return "inf" if value == math.inf else value


def _fields(group: type, values: dict[str, Any]) -> dict[str, Any]:
    """Field values of one group from JSON or TOML, checked by name and type."""
    defaults = {f.name: getattr(group(), f.name) for f in dataclasses.fields(group)}
    checked = {}
    for name, value in values.items():
        if name not in defaults:
            raise ValueError(f"found the setting {name!r}, expected one of {', '.join(defaults)}")
        checked[name] = _coerced(name, value, defaults[name])
    return checked


def _coerced(name: str, value: Any, default: Any) -> Any:  # noqa: ANN401  see _plain
    match default, value:
        case tuple(), list() if all(type(item) is int for item in value):
            return tuple(value)
        case float(), "inf":
            return math.inf
        case float(), int() | float() if not isinstance(value, bool):
            return float(value)
        case int(), float() if not isinstance(default, bool) and value == int(value):
            return int(value)
        case _ if type(value) is type(default):
            return value
    raise ValueError(
        f"{name} is {value!r}, expected a {type(default).__name__} such as {default!r}"
    )
