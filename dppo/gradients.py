"""The gradients of one update for several slots side by side: one row of numbers per slot.

Shape letters: S slots · n rows of a minibatch · O, A, K as in `distributions` · P parameters.

A slot's row never depends on which slots lie beside it: every matrix product is done slot by slot
(NumPy loops over the first axis), and everything else is element by element. Rows are *sums over
samples*, so that adding slots and dividing by the added weights gives the mean over all samples.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Self

import numpy as np
from numpy.typing import NDArray

from dppo.config import Config, SafetyConfig
from dppo.distributions import Distribution
from dppo.experience import Experience
from dppo.losses import kl_weight, policy_objective, sigma_of, softplus_derivative
from dppo.moments import FloatArray
from dppo.networks import Networks, row_of_ones
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

    @classmethod
    def from_vector(cls, vector: FloatArray) -> Self:
        """From the form that travels, the fields in order."""
        return cls(**dict(zip(_COLUMN, map(float, vector), strict=True)))

    @property
    def mean_kl(self) -> float:
        """Mean KL[π_old‖π] over samples [nats]."""
        return self.kl / self.kl_weight if self.kl_weight else 0.0


_COLUMN = {field.name: index for index, field in enumerate(fields(Sums))}


@dataclass(frozen=True, slots=True, kw_only=True)
class Minibatch:
    """Which of a slot's samples one update uses; None: that part of the update is over."""

    policy: Rows | None
    critics: Rows | None


class Minibatches:
    """Of one iteration. Every pass over a slot's samples is one permutation, kept for its updates.

    Example:
        minibatches = Minibatches(config, iteration=3)
        rows = minibatches.of(slot=0, update=1, stored=256).policy
    """

    def __init__(self, config: Config, iteration: int) -> None:
        """Nothing is drawn yet."""
        self._config, self._iteration = config, iteration
        self._orders: dict[tuple[int, int, int], Rows] = {}

    def of(self, slot: int, update: int, stored: int) -> Minibatch:
        """Of update 0 <= u < updates of a slot that holds `stored` critic samples."""
        settings, samples = self._config.update, self._config.rollout.samples_per_slot
        policy = critics = None
        if update < settings.policy_updates:
            policy = self._slice(slot, update, settings.num_minibatches, samples)
        if update < settings.critic_updates:
            critics = self._slice(slot, update, settings.critic_slices, stored)
        return Minibatch(policy=policy, critics=critics)

    def _slice(self, slot: int, update: int, slices: int, samples: int) -> Rows:
        if slices == 1:
            return np.arange(samples)  # a full batch, as it is
        epoch, index = divmod(update, slices)
        place, size = (slot, epoch, samples), samples // slices
        if place not in self._orders:
            draws = stream(self._config.run.seed, "minibatch", slot, self._iteration, epoch)
            self._orders[place] = draws.permutation(samples)
        return self._orders[place][index * size : (index + 1) * size]


def block_gradient(
    networks: Networks,
    distribution: Distribution,
    parameters: Float32,
    experiences: Sequence[Experience],
    minibatches: Sequence[Minibatch],
    beta: float,
    config: Config,
) -> tuple[Float32, FloatArray]:
    """Gradients of L = −J + L_V + L_σ of each slot, times its number of samples, and sums.

    Args:
        networks: layout of the vector.
        distribution: of the actions.
        parameters: [P] at this update.
        experiences: of each slot, from the same parameters; their advantages are known.
        minibatches: of each slot; equally long.
        beta: β.
        config: of the run.

    Returns:
        [S, P] vectors and [S, 7] `Sums`. A slot whose KL exceeds the stop under `--kl-scope
        worker`, or whose minibatch has no policy rows, has a zero policy part of weight 0: the
        skip token (Heess et al., Algorithm 3: "break").
    """
    vectors = np.empty((len(experiences), networks.size), np.float32)
    sums = np.zeros((len(experiences), len(_COLUMN)))
    active = [index for index, batch in enumerate(minibatches) if batch.policy is not None]
    if active:
        everyone = len(active) == len(experiences)
        chosen = [experiences[index] for index in active]
        rows = [batch.policy for batch in minibatches if batch.policy is not None]
        part = vectors[:, networks.parts["policy"]]
        gradient = part if everyone else np.empty((len(active), part.shape[1]), np.float32)
        sums[active] = _policy_gradient(
            networks, distribution, parameters, chosen, rows, beta, config, gradient
        )
        if not everyone:
            part[:] = 0
            part[active] = gradient
    else:
        vectors[:, networks.parts["policy"]] = 0
    fitted = [batch.critics for batch in minibatches if batch.critics is not None]
    if fitted:
        losses = _critic_gradients(
            networks, parameters, experiences, fitted, config.safety, vectors
        )
        sums[:, _COLUMN["critic_weight"]] = len(fitted[0])
        for name, loss in zip(("value_loss", "variance_loss"), losses, strict=False):
            sums[:, _COLUMN[name]] = loss
    else:
        vectors[:, networks.critics] = 0
    return vectors, sums


def skips(sums: FloatArray) -> NDArray[np.bool_]:
    """[S] whose policy part is a skip token: KL measured, no gradient; from rows of `Sums`."""
    return sums[:, _COLUMN["kl_weight"]] > sums[:, _COLUMN["policy_weight"]]


def slot_kls(
    networks: Networks,
    distribution: Distribution,
    parameters: Float32,
    experiences: Sequence[Experience],
) -> tuple[FloatArray, FloatArray]:
    """[S] sums of KL[π_old‖π] over all samples of each slot, which move β; [S] samples."""
    policy, log_std = networks.split_policy(parameters)
    columns, old_log_std = experiences[0].columns, experiences[0].log_std_old
    table = np.stack([experience.policy for experience in experiences])
    output, _ = networks.policy.forward(policy, columns.obs(table))
    kl = distribution.kl(columns.output_old(table), old_log_std, output, log_std)
    sums: FloatArray = kl.astype(np.float64).sum(axis=1)
    return sums, np.full(len(kl), float(kl.shape[1]))


def _gather(tables: Sequence[Float32], rows: Sequence[Rows]) -> Float32:
    """The chosen rows of each slot's table, [S, n, F]."""
    chosen = np.empty((len(rows), len(rows[0]), tables[0].shape[1]), np.float32)
    for target, table, index in zip(chosen, tables, rows, strict=True):
        table.take(index, axis=0, out=target, mode="clip")  # no index is out of bounds
    return chosen


def _policy_gradient(
    networks: Networks,
    distribution: Distribution,
    parameters: Float32,
    experiences: Sequence[Experience],
    rows: Sequence[Rows],
    beta: float,
    config: Config,
    gradient: Float32,
) -> FloatArray:
    """∂(−J)/∂θ = −ratio A ∂log π + (β + hinge) ∂KL, summed over samples, into [S, policy's part].

    Returns:
        [S, 7] `Sums` of the policy.
    """
    policy, log_std = networks.split_policy(parameters)
    old_log_std = experiences[0].log_std_old  # the same for all: π_old's parameter
    columns, table = experiences[0].columns, _gather([e.policy for e in experiences], rows)
    old, action = columns.output_old(table).copy(), columns.action(table).copy()
    output, inputs = networks.policy.forward(policy, columns.obs(table))

    count = output.shape[1]
    kl_sums = distribution.kl(old, old_log_std, output, log_std).astype(np.float64).sum(axis=1)
    kl = kl_sums / count
    log_prob = distribution.log_prob(output, log_std, action)
    ratio = np.exp(log_prob - columns.log_prob_old(table))
    gain = ratio * columns.advantage(table)
    weight = kl_weight(kl, beta, config.kl).astype(np.float32)
    stopped = (kl > config.kl.kl_stop * config.kl.kl_target) & (config.kl.kl_scope == "worker")

    d_log_prob, d_log_prob_std = distribution.log_prob_gradient(output, log_std, action)
    d_kl, d_kl_std = distribution.kl_gradient(old, old_log_std, output, log_std)
    g, w = gain[..., None], weight[:, None, None]
    networks.policy.backward(
        policy, inputs, w * d_kl - g * d_log_prob, gradient[:, : networks.policy.size]
    )
    if networks.log_std_size:
        slope = w * d_kl_std - g * d_log_prob_std
        gradient[:, networks.policy.size :] = (row_of_ones(count) @ slope)[:, 0]
    gradient[stopped] = 0.0
    facts = np.zeros((len(rows), len(_COLUMN)))
    facts[:, _COLUMN["policy_weight"]] = np.where(stopped, 0.0, count)
    facts[:, _COLUMN["kl_weight"]] = count
    facts[:, _COLUMN["kl"]] = kl_sums
    objective = policy_objective(gain, kl, beta, config.kl) * count
    facts[:, _COLUMN["objective"]] = np.where(stopped, 0.0, objective)
    return facts


def _critic_gradients(
    networks: Networks,
    parameters: Float32,
    experiences: Sequence[Experience],
    rows: Sequence[Rows],
    config: SafetyConfig,
    vectors: Float32,
) -> FloatArray:
    """∂L/∂parameters of the critics, summed over samples, into `vectors` [S, P]; L [C, S].

    L = (target − prediction)²; σ's prediction is `sigma_of` the output. The
    C critics (V, and σ if there is one) have one shape and see the same rows: one product a layer.
    """
    count = 2 if networks.has_variance else 1
    mlp, critics = networks.value, networks.critics
    columns, table = experiences[0].columns, _gather([e.critics for e in experiences], rows)
    vector = parameters[critics].reshape(count, 1, mlp.size)
    output, inputs = mlp.forward(vector, columns.obs(table))
    raw = output[..., 0]
    error = np.empty(raw.shape, np.float32)
    np.subtract(raw[0], columns.v_target(table), out=error[0])
    if count == 2:
        np.subtract(sigma_of(raw[1], config), columns.sigma_target(table), out=error[1])
    slope = 2 * error
    if count == 2 and config.sigma_head == "softplus":
        slope[1] *= softplus_derivative(raw[1])
    gradient = vectors[:, critics].reshape(len(rows), count, mlp.size).swapaxes(0, 1)
    mlp.backward(vector, inputs, slope[..., None], gradient)
    losses: FloatArray = np.square(error.astype(np.float64)).sum(axis=-1)
    return losses
