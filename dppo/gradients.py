"""One slot's gradient of one update: a flat vector and the sums that go with it.

Vectors and sums are *sums over samples*, so that adding slots and dividing by the added weights
gives the mean over all samples, whatever each slot contributed.
"""

from dataclasses import astuple, dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from dppo.config import Config
from dppo.distributions import Distribution
from dppo.losses import kl_weight, policy_objective, softplus, softplus_derivative, squared_error
from dppo.moments import FloatArray
from dppo.networks import Network, Networks
from dppo.rollout import Experience
from dppo.streams import stream

Float32 = NDArray[np.float32]
Rows = NDArray[np.int64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Sums:
    """Scalars that are added over slots along the same tree as the vectors."""

    policy_weight: float = 0.0
    """Samples behind the policy's gradient; 0 in a skip token."""
    critic_weight: float = 0.0
    """Samples behind the critics' gradients."""
    kl_weight: float = 0.0
    """Samples behind `kl`."""
    kl: float = 0.0
    """Sum of KL[π_old‖π] over samples [nats]."""
    objective: float = 0.0
    """Sum of J over samples."""
    value_loss: float = 0.0
    """Sum of squared errors of V."""
    variance_loss: float = 0.0
    """Sum of squared errors of σ, in units of the network's output."""

    def to_vector(self) -> FloatArray:
        """The form that travels."""
        return np.array(astuple(self))

    @classmethod
    def from_vector(cls, vector: FloatArray) -> Self:
        """The inverse of `to_vector`."""
        return cls(**dict(zip(cls.__slots__, map(float, vector), strict=True)))

    @property
    def mean_kl(self) -> float:
        """Mean KL[π_old‖π] over samples [nats]."""
        return self.kl / self.kl_weight if self.kl_weight else 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Minibatch:
    """Which samples one update uses; None: that part of the update is over."""

    policy: Rows | None
    critics: Rows | None

    @classmethod
    def of(cls, config: Config, slot: int, iteration: int, update: int, stored: int) -> Self:
        """The minibatch of update 0 <= u < updates of a slot that holds `stored` critic samples.

        Every pass over the data is one permutation, drawn from (seed, slot, iteration, pass).
        """
        settings, samples = config.update, config.rollout.samples_per_slot
        policy = critics = None
        if update < settings.policy_updates:
            policy = _slice(config, slot, iteration, update, settings.num_minibatches, samples)
        if update < settings.critic_updates:
            critics = _slice(config, slot, iteration, update, settings.critic_slices, stored)
        return cls(policy=policy, critics=critics)


def _slice(
    config: Config, slot: int, iteration: int, update: int, slices: int, samples: int
) -> Rows:
    if slices == 1:
        return np.arange(samples)
    epoch, index = divmod(update, slices)
    order = stream(config.run.seed, "minibatch", slot, iteration, epoch).permutation(samples)
    size = samples // slices
    return order[index * size : (index + 1) * size]


def slot_gradient(
    networks: Networks, distribution: Distribution, parameters: Float32, experience: Experience,
    advantage: Float32, minibatch: Minibatch, beta: float, config: Config,
) -> tuple[Float32, Sums]:  # fmt: skip
    """Gradient of L = −J + L_V + L_σ, times the number of samples, and its sums.

    Args:
        networks: layout of the vector.
        distribution: of the actions.
        parameters: [P] at this update.
        experience: the slot's iteration.
        advantage: [N] A, standardised over all slots.
        minibatch: rows of this update.
        beta: β.
        config: of the run.

    Returns:
        [P] vector, and sums. A slot whose KL exceeds the stop under `--kl-scope worker` sends a
        skip token: a zero policy part of weight 0 (Heess et al., Algorithm 3: "break").
    """
    gradient = np.zeros(networks.size, np.float32)
    sums = Sums()
    if minibatch.policy is not None:
        part = gradient[networks.parts["policy"]]
        sums = _policy_gradient(
            networks, distribution, parameters, experience, advantage, minibatch.policy, beta,
            config, part,
        )  # fmt: skip
    if minibatch.critics is None:
        return gradient, sums
    rows = minibatch.critics
    obs = experience.critic_obs[rows]
    value_loss = _critic_gradient(networks, "value", parameters, obs, experience.v_target[rows],
                                  False, gradient)  # fmt: skip
    variance_loss = 0.0
    if networks.variance is not None:
        variance_loss = _critic_gradient(
            networks, "variance", parameters, obs, experience.sigma_target[rows],
            config.safety.sigma_head == "softplus", gradient,
        )  # fmt: skip
    return gradient, Sums(
        policy_weight=sums.policy_weight, critic_weight=float(len(rows)), kl_weight=sums.kl_weight,
        kl=sums.kl, objective=sums.objective, value_loss=value_loss, variance_loss=variance_loss,
    )  # fmt: skip


def slot_kl(
    networks: Networks, distribution: Distribution, parameters: Float32, experience: Experience
) -> Sums:
    """KL[π_old‖π] over all of a slot's samples: what β is adapted by."""
    policy, log_std = networks.split_policy(parameters)
    output, _ = networks.policy.forward(policy, experience.obs)
    kl = distribution.kl(experience.output_old, experience.log_std_old, output, log_std)
    return Sums(kl=float(kl.sum(dtype=np.float64)), kl_weight=float(len(kl)))


def _policy_gradient(
    networks: Networks, distribution: Distribution, parameters: Float32, experience: Experience,
    advantage: Float32, rows: Rows, beta: float, config: Config, gradient: Float32,
) -> Sums:  # fmt: skip
    """∂(−J)/∂θ = −ratio A ∂log π + (β + hinge) ∂KL, summed over samples, into `gradient`."""
    policy, log_std = networks.split_policy(parameters)
    old, old_log_std = experience.output_old[rows], experience.log_std_old
    action, a = experience.action[rows], advantage[rows]
    output, inputs = networks.policy.forward(policy, experience.obs[rows])

    kls = distribution.kl(old, old_log_std, output, log_std)
    total, count = float(kls.sum(dtype=np.float64)), float(len(rows))
    kl = total / count
    if config.kl.kl_scope == "worker" and kl > config.kl.kl_stop * config.kl.kl_target:
        return Sums(kl=total, kl_weight=count)

    log_prob = distribution.log_prob(output, log_std, action)
    ratio = np.exp(log_prob - experience.log_prob_old[rows])
    d_log_prob, d_log_prob_std = distribution.log_prob_gradient(output, log_std, action)
    d_kl, d_kl_std = distribution.kl_gradient(old, old_log_std, output, log_std)
    gain = (ratio * a)[:, None]
    weight = np.float32(kl_weight(kl, beta, config.kl))
    size = networks.policy.size
    networks.policy.backward(policy, inputs, weight * d_kl - gain * d_log_prob, gradient[:size])
    np.sum(weight * d_kl_std - gain * d_log_prob_std, axis=0, out=gradient[size:])
    objective = policy_objective(ratio, a, kl, beta, config.kl)
    return Sums(policy_weight=count, kl_weight=count, kl=total, objective=objective * count)


def _critic_gradient(
    networks: Networks, name: Network, parameters: Float32, obs: Float32, target: Float32,
    positive: bool, gradient: Float32,
) -> float:  # fmt: skip
    """∂L/∂parameters of one critic, summed over samples, into `gradient`; L itself."""
    mlp = networks.value if name == "value" else networks.variance
    assert mlp is not None
    part = networks.parts[name]
    output, inputs = mlp.forward(parameters[part], obs)
    raw = output[:, 0]
    slope, loss = squared_error(softplus(raw) if positive else raw, target)
    if positive:
        slope = slope * softplus_derivative(raw)
    mlp.backward(parameters[part], inputs, slope[:, None], gradient[part])
    return loss
