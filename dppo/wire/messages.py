"""The whole vocabulary between the learner and its workers.

    worker                                learner
      | -- Hello ------------------------> |   again and again until a Welcome comes
      | <---------------------- Welcome -- |   run, generation, configuration
      | -- Ready ------------------------> |   sizes of the environment
      | <---------------------- Restore -- |   a slot's environments, if the worker lacks them
      | <---------------------- Collect -- |   iteration i: parameters, statistics, ψ, β, slots
      | -- Collected --------------------> |   one per slot: moments, episodes, snapshot
      | <----------------------- Update -- |   update u: parameters, advantage moments, slots
      | -- Gradient ---------------------> |   one per aligned block of slots
      | <---------------------- Measure -- |   parameters after the last update
      | -- Measured ---------------------> |   one per block: KL over all samples
      | <------------------------- Stop -- |   with a reason
      | -- Alive ------------------------> |   twice a second: how much is done
      | -- Failure ----------------------> |   a slot or an environment that cannot go on

Answers repeat the (generation, iteration, round) of the question; others are ignored. Any message
but Hello may be lost with its connection: the learner then leases the slots anew, the worker says
Hello again. There is no acknowledgement: the answer is one.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

VERSION = 5
"""Another one for every change of messages or snapshots: a mixed cluster is told so at once."""

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Hello:
    """A worker asks to join. Of any version, so its form stays as it is for ever, like `Stop`'s.

    Example:
        Hello(worker="w-3f2a", host="lab1", pid=7, numerics="9c1e", versions="mujoco 4.0.0",
              served_run="5b7d", served_generation=2)
    """

    worker: str
    """Unique among the workers of a run: a new name for every process."""
    host: str
    pid: int
    numerics: str
    """Hash of a fixed computation: equal where floating point gives equal bits."""
    versions: str
    """Versions of the libraries that decide the bits."""
    served_run: str = ""
    """Run that the worker has served last; empty: none."""
    served_generation: int = 0
    """Highest generation of that run that it has served: a lower one is of the past."""
    protocol: int = VERSION
    """Version of the messages that it understands."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Ready:
    """The worker has built the environment; sizes as in `dppo.spaces.Spaces`.

    Example:
        Ready(worker="w-3f2a", generation=1, obs_size=27, action_kind="box", action_sizes=(8,),
              env_hash="5d41", exact="captured")
    """

    worker: str
    generation: int
    obs_size: int
    action_kind: str
    action_sizes: tuple[int, ...]
    env_hash: str
    """Hash of the model XML, empty for environments without one."""
    exact: str
    """How a slot's environments move: captured, replayed, or off."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Collected:
    """A slot has run its T steps.

    Example:
        Collected(worker="w-3f2a", generation=1, iteration=0, round=0, slot=3, ...)
    """

    worker: str
    generation: int
    iteration: int
    round: int
    slot: int
    obs: Float64  # moments [1 + 2 O] of the raw observations
    returns: Float64  # moments [3] of the running discounted return
    reward: Float64  # moments [3] of r_t
    advantages: Float64  # moments [7] of A_V, A_σ, A_V − ψ A_σ
    fit: Float64  # moments [7] of target of V, target − V, σ
    sigma_target: Float64  # moments [3]
    start_sigma: Float64  # moments [3] of σ(s_0)
    episodes: Float64  # [2 k]  return and length of each finished episode, in order
    exact: bool
    """False: an environment of the slot could not be moved without losing bits."""
    snapshot: bytes
    """The slot's environments after this iteration."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Gradient:
    """The sum of the gradients of an aligned block of slots.

    Example:
        Gradient(worker="w-3f2a", generation=1, iteration=0, round=1, first=4, size=4, ...)
    """

    worker: str
    generation: int
    iteration: int
    round: int
    first: int
    size: int
    stopped: tuple[int, ...]
    """Slots of the block that have stopped their policy updates by themselves."""
    vector: Float32  # [P] sum over samples
    sums: Float64  # `dppo.gradients.Sums`


@dataclass(frozen=True, slots=True, kw_only=True)
class Measured:
    """KL[π_old‖π] of each slot of an aligned block after the iteration's updates.

    Example:
        Measured(worker="w-3f2a", generation=1, iteration=0, round=11, first=4, size=4, ...)
    """

    worker: str
    generation: int
    iteration: int
    round: int
    first: int
    size: int
    kls: Float64  # [size] of each slot, sum over its samples [nats]
    weights: Float64  # [size] samples


@dataclass(frozen=True, slots=True, kw_only=True)
class Alive:
    """A sign of life, twice a second from when the worker is ready; lost ones do no harm.

    Example:
        Alive(worker="w-3f2a", generation=1, done=48211)
    """

    worker: str
    generation: int
    done: int
    """Steps and tasks since the process began: as long as it grows, nothing hangs."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Failure:
    """Something went wrong that may be a person's to mend; a sentence says where and what.

    Example:
        Failure(worker="w-3f2a", generation=1, usage=False, slot=3, reason="slot 3, ...")
    """

    worker: str
    generation: int
    slot: int
    """Whose environment failed; -1: none, `usage` is true."""
    usage: bool
    """True: the settings ask for something impossible; False: it happened on the way."""
    reason: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Welcome:
    """The learner knows the worker.

    Example:
        Welcome(run="3f9c", generation=1, config='{"run": {...}, ...}', name="main")
    """

    run: str
    """Random id of the run; a copy of its folder has the same."""
    generation: int
    config: str
    """`Config.to_dict` as JSON."""
    name: str = ""
    """Name of the run's folder, for people."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Restore:
    """A slot's environments at the start of an iteration.

    Example:
        Restore(generation=1, iteration=4, slot=3, snapshot=b"...")
    """

    generation: int
    iteration: int
    slot: int
    snapshot: bytes


@dataclass(frozen=True, slots=True, kw_only=True)
class Collect:
    """Run the policy for T steps on each of `slots`.

    Example:
        Collect(generation=1, iteration=4, round=0, slots=(0, 1), psi=0.1, beta=1.0,
                mean_reward=2.5, ...)
    """

    generation: int
    iteration: int
    round: int
    slots: tuple[int, ...]
    psi: float
    beta: float
    mean_reward: float
    """Of a step, over the iteration before."""
    parameters: Float32  # [P]
    obs: Float64  # moments [1 + 2 O]
    returns: Float64  # moments [3]
    sigma_target: Float64  # moments [3]


@dataclass(frozen=True, slots=True, kw_only=True)
class Update:
    """Compute the gradient of update `round - 1` on each of `slots`.

    Example:
        Update(generation=1, iteration=4, round=1, slots=(0, 1), stopped=(), ...)
    """

    generation: int
    iteration: int
    round: int
    slots: tuple[int, ...]
    stopped: tuple[int, ...]
    """Slots whose policy updates are over for this iteration."""
    parameters: Float32  # [P]
    advantages: Float64  # moments [7] over all slots


@dataclass(frozen=True, slots=True, kw_only=True)
class Measure:
    """Measure KL[π_old‖π] on each of `slots`.

    Example:
        Measure(generation=1, iteration=4, round=11, slots=(0, 1), parameters=...)
    """

    generation: int
    iteration: int
    round: int
    slots: tuple[int, ...]
    parameters: Float32  # [P]


@dataclass(frozen=True, slots=True, kw_only=True)
class Stop:
    """The run is over for this worker. Understood by any version: its form stays as it is.

    Example:
        Stop(reason="finished", final=True)
    """

    reason: str
    final: bool
    """False: the learner pauses; a worker with its own address waits for the next one."""
    sent_away: bool = False
    """The run goes on without it; it ends with exit code 1."""


Answer = Collected | Gradient | Measured
Task = Collect | Update | Measure
ToLearner = Hello | Ready | Alive | Answer | Failure
ToWorker = Welcome | Restore | Task | Stop
Message = ToLearner | ToWorker
