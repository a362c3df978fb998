"""The chief: Algorithm 2 of Heess et al. 2017.

    for i in {1, ..., N}:                                              iterate
        workers run the policy                                         _collect
        for m in {1, ..., M}, b in {1, ..., B}:                        _improve
            wait until at least W - D gradients are available          _exchange.gather
            average them and update θ and φ                            _apply
        adapt the KL coefficient                                       _adapt

Policy, value and variance share their rounds: one message carries all three gradients. Waiting,
leases and lost workers are in `exchange.py`; who was dropped in `ledger.py`; files and figures in
`runlog.py`.
"""

from dataclasses import replace
from typing import cast

import numpy as np
from numpy.typing import NDArray

from dppo.adam import adam, clipped
from dppo.config import Config
from dppo.distributions import mean_std
from dppo.gradients import Sums
from dppo.losses import AdvantageStatistics
from dppo.moments import Moments, merged
from dppo.networks import Networks
from dppo.normalizer import Statistics
from dppo.rounds import Round
from dppo.schedules import (
    adapt_kl_coef,
    adapt_servo,
    dual_psi,
    learning_rate_factor,
    scheduled_psi,
)
from dppo.sums import block_sum, whole
from dppo.wire.messages import Answer, Collect, Collected, Gradient, Measure, Measured, Update
from learner.exchange import Exchange
from learner.ledger import Ledger
from learner.report import Finished, Training
from learner.state import State

Float32 = NDArray[np.float32]


class Chief:
    """The only one that changes parameters."""

    def __init__(
        self,
        state: State,
        networks: Networks,
        config: Config,
        generation: int,
        exchange: Exchange,
        ledger: Ledger,
    ) -> None:
        self.state = state
        self._networks, self._config, self._generation = networks, config, generation
        self._exchange, self._ledger = exchange, ledger
        self._parameters, self._optimizers = state.parameters, state.optimizers
        part, head = networks.parts["policy"], networks.policy.size
        self._rate_factors = np.ones(part.stop - part.start, np.float32)
        self._rate_factors[head:] = networks.log_std_rate(config.network)

    def iterate(self) -> Finished:
        """One iteration: collect, M and B updates, adaptation. `state` is then the next one's.

        The caller notes it in the ledger, and makes its report, when there is time.
        """
        before, psi = self.state, self._psi()
        collected = self._collect(psi)
        advantages = merged([answer.advantages for answer in collected])
        training = Training(psi, before.beta, AdvantageStatistics(advantages).stds)
        if before.iteration > 0:  # the first one only fills the shared statistics
            self._improve(advantages, training)
            self._adapt(collected, training)
        training.std = mean_std(self._networks.split_policy(self._parameters)[1])
        self._advance(collected, training)
        return Finished(
            before=before,
            after=self.state,
            collected=collected,
            training=training,
            config=self._config,
            num_workers=self._exchange.num_workers,
        )

    def _improve(self, advantages: Moments, training: Training) -> None:
        """M updates of the policy and B of the critics, each from at least W - D gradients."""
        updates, stopped = self._config.update.updates, set[int]()
        for update in range(updates):
            gradients = self._exchange.gather(
                Update(
                    generation=self._generation,
                    iteration=self.state.iteration,
                    round=1 + update,
                    slots=self._ledger.slots(self.state.iteration, update),
                    stopped=tuple(sorted(stopped)),
                    parameters=self._parameters,
                    advantages=advantages.to_vector(),
                ),
                quorum=self._config.rollout.quorum,
            )
            stopped |= self._apply(gradients, training)
            training.dropped += self._ledger.updated(gradients, self._parameters)
        measured = self._exchange.gather(
            Measure(
                generation=self._generation,
                iteration=self.state.iteration,
                round=1 + updates,
                slots=self._slots,
                parameters=self._parameters,
            ),
            quorum=self._config.rollout.slots,
        )
        answers = cast("list[Measured]", list(measured.answers.values()))
        training.kls = [
            (float(kl), float(weight))
            for answer in sorted(answers, key=lambda a: a.first)
            for kl, weight in zip(answer.kls, answer.weights, strict=True)
        ]

    @property
    def _slots(self) -> tuple[int, ...]:
        return tuple(range(self._config.rollout.slots))

    def _psi(self) -> float:
        """ψ of this iteration: moved by dual steps, or on its schedule."""
        if np.isfinite(self._config.safety.variance_limit):
            return self.state.psi
        return scheduled_psi(self._config.safety, self.state.iteration / self._config.iterations)

    def _collect(self, psi: float) -> list[Collected]:
        """Every slot runs T steps; all of them must be in, whatever D is. In slot order."""
        state = self.state
        collect = Collect(
            generation=self._generation,
            iteration=state.iteration,
            round=0,
            slots=self._slots,
            psi=float(psi),  # settings made in Python may hold whole numbers
            beta=float(state.beta),
            mean_reward=state.mean_reward,
            parameters=state.parameters,
            **state.statistics.to_vectors(),
        )
        self._parameters, self._optimizers = state.parameters, state.optimizers
        self._exchange.begin_iteration(collect, state.snapshots)
        answers = self._exchange.gather(collect, quorum=self._config.rollout.slots).answers
        return [cast("Collected", answers[slot, 1]) for slot in self._slots]

    def _apply(self, gradients: Round[Answer], training: Training) -> set[int]:
        """Average the accepted gradients, clip, one Adam update per network; slots that stop."""
        answers = cast("dict[tuple[int, int], Gradient]", gradients.answers)
        root = whole(self._config.rollout.slots)
        vector = block_sum({block: answer.vector for block, answer in answers.items()}, root)
        total = block_sum({block: answer.sums for block, answer in answers.items()}, root)
        sums = Sums.from_vector(total)
        stop = self._stops(sums)
        training.note(sums, stop)
        if not stop:
            self._change(vector, sums, training)
            return {slot for answer in answers.values() for slot in answer.stopped}
        self._change(vector, replace(sums, policy_weight=0.0), training)
        return set(self._slots)

    def _stops(self, sums: Sums) -> bool:
        """KL > 4 KL_target, on the mean over the accepted gradients: policy updates end here."""
        kl = self._config.kl
        return kl.kl_scope == "chief" and sums.mean_kl > kl.kl_stop * kl.kl_target

    def _change(self, vector: Float32, sums: Sums, training: Training) -> None:
        """θ, φ and the variance network's parameters after one update each."""
        settings, state = self._config.update, self.state
        factor = learning_rate_factor(self._config, state.iteration)
        parameters, optimizers = self._parameters.copy(), dict(self._optimizers)
        for name, part in self._networks.parts.items():
            weight = sums.policy_weight if name == "policy" else sums.critic_weight
            if weight == 0:
                continue
            rate: Float32 | float = factor * settings.critic_learning_rate
            if name == "policy":
                rate = self._policy_rates(factor * state.servo * settings.learning_rate)
            mean, norm = clipped(vector[part] / np.float32(weight), settings.max_grad_norm)
            optimizers[name], change = adam(optimizers[name], mean, rate, eps=settings.adam_eps)
            parameters[part] += change
            training.note_norm(name, norm)
        self._parameters, self._optimizers = parameters, optimizers

    def _policy_rates(self, rate: float) -> Float32:
        """[policy's part] step sizes; log std has a factor of its own."""
        return np.float32(rate) * self._rate_factors

    def _adapt(self, collected: list[Collected], training: Training) -> None:
        """β (and the servo) by the final KL, ψ by σ(s_0) under a variance limit."""
        state, config = self.state, self._config
        beta, servo, psi = state.beta, state.servo, state.psi
        if config.kl.kl_scope == "chief":
            beta = adapt_kl_coef(beta, training.kl, config.kl)
        else:
            for kl, weight in training.kls:
                beta = adapt_kl_coef(beta, kl / weight, config.kl, config.rollout.slots)
        if config.update.lr_schedule == "servo":
            servo = adapt_servo(servo, beta, training.kl, config.kl)
        starts = merged([answer.start_sigma for answer in collected])
        if starts.count > 0:
            psi = dual_psi(psi, float(starts.mean[0]), config.safety)
        self.state = replace(state, beta=beta, servo=servo, psi=psi)

    def _advance(self, collected: list[Collected], training: Training) -> None:
        """On to the next iteration: statistics and episodes merged in slot order."""
        state, statistics = self.state, self.state.statistics
        for answer in collected:
            found = Statistics.from_vectors(answer.obs, answer.returns, answer.sigma_target)
            if state.iteration == 0:  # σ's targets have no scale yet: decision 0009
                found = replace(found, sigma_target=Moments.empty(1))
            statistics = statistics.merge(found)
        episodes = [answer.episodes.reshape(-1, 2) for answer in collected]
        self.state = replace(
            state.with_episodes(np.concatenate(episodes)),
            iteration=state.iteration + 1,
            parameters=self._parameters,
            optimizers=self._optimizers,
            statistics=statistics,
            mean_reward=float(merged([answer.reward for answer in collected]).mean[0]),
            dropped_gradients=state.dropped_gradients + training.dropped,
            snapshots={answer.slot: answer.snapshot for answer in collected},
        )
