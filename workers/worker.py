"""The worker: Algorithm 3 of Heess et al. 2017, for every slot this process leases.

    for i in {1, ..., N}:                                              Collect
        run the policy for T steps; estimate advantages                _collect
        π_old <- π
        for m in {1, ..., M}, b in {1, ..., B}:                        Update
            if KL[π_old|π] > 4 KL_target: no more policy updates       (the chief says so; with
                                                          --kl-scope worker: block_gradient)
            gradients of J, L_V and L_σ; send; wait for the next θ     _update
        KL[π_old|π] for the adaptation of β                            _measure

Waiting, joining and dying are in `membership.py`; this file is the algorithm.
"""

from collections.abc import Iterator
from itertools import compress

import numpy as np
from numpy.typing import NDArray

from dppo.config import Config
from dppo.distributions import distribution_of
from dppo.experience import Experience
from dppo.gradients import Minibatch, Minibatches, block_gradient, skips, slot_kls
from dppo.losses import AdvantageStatistics, combine
from dppo.machine import give_back_memory
from dppo.moments import Moments
from dppo.networks import Networks
from dppo.normalizer import Statistics
from dppo.rollout import prepare
from dppo.schedules import in_iteration
from dppo.spaces import Spaces
from dppo.sums import Block, aligned_blocks, members, sum_rows
from dppo.wire.links import WorkerLink
from dppo.wire.messages import Collect, Collected, Gradient, Measure, Measured, Restore, Update
from workers.core import Core
from workers.slots import Slots

Float32 = NDArray[np.float32]


def _rows_of_blocks(slots: tuple[int, ...]) -> Iterator[tuple[Block, slice]]:
    """Aligned blocks, and where each lies among the slots: as neighbours, in order."""
    for first, size in aligned_blocks(slots):
        start = slots.index(first)
        yield (first, size), slice(start, start + size)


class OutOfStepError(Exception):
    """The learner asks for a slot whose state this worker does not have: join anew."""


class Worker:
    """The slots of one process. `perform` answers one message of the learner."""

    def __init__(
        self,
        name: str,
        link: WorkerLink,
        spaces: Spaces,
        config: Config,
        core: Core | None = None,
    ) -> None:
        """Nothing is built yet; `core` is let go of when environments are."""
        self._name, self._link, self._config = name, link, config
        self._core = core or Core()
        self._networks = Networks.build(spaces, config)
        self._distribution = distribution_of(spaces)
        self._slots: Slots | None = None
        self._boundary: dict[int, tuple[int, bytes]] = {}
        """Of each slot, the iteration it will collect next, and its snapshot."""
        self._experiences: dict[int, Experience] = {}
        self._complete: set[int] = set()
        """Slots whose experience has its advantage."""
        self._collect_task: Collect | None = None
        self._minibatches = Minibatches(config, 0)

    def perform(self, task: Restore | Collect | Update | Measure) -> None:
        """Do what the learner asks, and answer.

        Raises:
            OutOfStepError: the task needs a state that this worker does not have.
            EnvironmentFailedError: an environment raised or returned what is not finite.
        """
        match task:
            case Restore():
                self._restore(task)
            case Collect():
                self._collect(task)
            case Update():
                self._update(task)
            case Measure():
                self._measure(task)

    def close(self) -> None:
        """Close all environments."""
        if self._slots is not None:
            self._slots.close()

    def _restore(self, task: Restore) -> None:
        self._boundary[task.slot] = task.iteration, task.snapshot

    def _collect(self, task: Collect) -> None:
        """T steps per slot, V, σ, δ, A_V, A_σ and π_old; moments and snapshot to the chief."""
        slots = self._at_start(task)
        if self._collect_task is None or self._collect_task.iteration != task.iteration:
            self._experiences.clear()
            self._minibatches = Minibatches(self._config, task.iteration)
            self._boundary = {
                index: held for index, held in self._boundary.items() if held[0] >= task.iteration
            }
        self._collect_task = task
        statistics = Statistics.from_vectors(task.obs, task.returns, task.sigma_target)
        collected = slots.collect(self._networks, self._distribution, task.parameters, statistics)
        prepared = prepare(
            [rollout.judged(task.mean_reward, self._config.safety) for rollout, _ in collected],
            [slots.replays.get(index) for index in task.slots],
            self._networks,
            self._distribution,
            task.parameters,
            statistics,
            task.psi,
            in_iteration(self._config, task.iteration),
        )
        answers = []
        for index, (_, facts), (experience, kept, critics) in zip(
            task.slots, collected, prepared, strict=True
        ):
            if self._config.update.critic_replay and task.iteration > 0:  # it had no scales
                slots.replays[index] = kept
            self._experiences[index] = experience
            self._complete.discard(index)
            snapshot = slots.snapshot(index)
            self._boundary[index] = slots.iteration, snapshot
            answers.append(
                Collected(
                    worker=self._name,
                    generation=task.generation,
                    iteration=task.iteration,
                    round=task.round,
                    slot=index,
                    obs=facts.obs.to_vector(),
                    returns=facts.returns.to_vector(),
                    reward=facts.reward.to_vector(),
                    episodes=facts.episodes,
                    advantages=critics.advantages.to_vector(),
                    fit=critics.fit.to_vector(),
                    sigma_target=critics.sigma_target.to_vector(),
                    start_sigma=critics.start_sigma.to_vector(),
                    exact=slots.is_exact(index),
                    snapshot=snapshot,
                )
            )
        self._link.send(*answers)
        self._draw_ahead(task.slots, 0)

    def _update(self, task: Update) -> None:
        """The gradient of this update's minibatch, summed over each aligned block of slots."""
        vectors, sums = self._gradients(task)
        skipping, answers = skips(sums), []
        for block, rows in _rows_of_blocks(task.slots):
            first, size = block
            answers.append(
                Gradient(
                    worker=self._name,
                    generation=task.generation,
                    iteration=task.iteration,
                    round=task.round,
                    first=first,
                    size=size,
                    stopped=tuple(compress(members(block), skipping[rows])),
                    vector=sum_rows(vectors[rows]),
                    sums=sum_rows(sums[rows]),
                )
            )
        self._link.send(*answers)
        self._draw_ahead(task.slots, task.round)

    def _draw_ahead(self, slots: tuple[int, ...], update: int) -> None:
        """Draw the orders of the next update while the learner makes this one."""
        for index in slots:
            self._minibatches.of(index, update, len(self._experiences[index].critics))

    def _gradients(self, task: Update) -> tuple[Float32, NDArray[np.float64]]:
        """A row per slot of the task."""
        collect, experiences = self._collected(task)
        minibatches = []
        for index, experience in zip(task.slots, experiences, strict=True):
            if index not in self._complete:
                experience.advantage[:] = combine(
                    experience.a_v,
                    experience.a_sigma,
                    collect.psi,
                    AdvantageStatistics(Moments.from_vector(task.advantages)),
                    self._config.safety,
                )
                self._complete.add(index)
            rows = self._minibatches.of(index, task.round - 1, len(experience.critics))
            if index in task.stopped:
                rows = Minibatch(policy=None, critics=rows.critics)
            minibatches.append(rows)
        return block_gradient(
            self._networks,
            self._distribution,
            task.parameters,
            experiences,
            minibatches,
            collect.beta,
            self._config,
        )

    def _measure(self, task: Measure) -> None:
        """KL[π_old|π] over all samples of each slot, after the last update."""
        _, experiences = self._collected(task)
        kls, weights = slot_kls(self._networks, self._distribution, task.parameters, experiences)
        answers = []
        for (first, size), rows in _rows_of_blocks(task.slots):
            answers.append(
                Measured(
                    worker=self._name,
                    generation=task.generation,
                    iteration=task.iteration,
                    round=task.round,
                    first=first,
                    size=size,
                    kls=kls[rows],
                    weights=weights[rows],
                )
            )
        self._link.send(*answers)

    def _at_start(self, task: Collect) -> Slots:
        """The slots of a task side by side, ready to collect its iteration."""
        slots = self._slots
        if slots is not None:
            if slots.indices == task.slots and slots.iteration == task.iteration:
                return slots
            slots.close()
            self._slots = slots = None
            give_back_memory()
        self._core.release()  # environments may have threads of their own
        if task.iteration == 0:
            self._slots = Slots.fresh(task.slots, self._config)
            return self._slots
        snapshots = []
        for index in task.slots:
            iteration, snapshot = self._boundary.get(index, (-1, b""))
            if iteration != task.iteration:
                raise OutOfStepError(
                    f"slot {index} is not at the start of iteration {task.iteration}"
                )
            snapshots.append(snapshot)
        self._slots = Slots.restored(task.slots, self._config, task.iteration, snapshots)
        return self._slots

    def _collected(self, task: Update | Measure) -> tuple[Collect, list[Experience]]:
        """The task that collected this iteration, and what each slot learns from."""
        collect, held = self._collect_task, self._experiences
        if collect is None or collect.iteration != task.iteration or {*task.slots} - held.keys():
            raise OutOfStepError(f"slots {task.slots} have not collected {task.iteration}")
        return collect, [held[index] for index in task.slots]
