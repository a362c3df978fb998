"""A worker's life: find a learner, join it, do what it asks, outlive it.

connect -> Hello ... Welcome -> Ready -> tasks -> Stop(final) or the learner is lost -> Hello
"""

import json
import logging
import os
import socket
import time
from collections.abc import Callable

from dppo.backoff import Backoff
from dppo.config import Config
from dppo.errors import DppoError, UsageError
from dppo.wire.links import LearnerLost, Refused, WorkerLink
from dppo.wire.messages import (
    Collect,
    Failure,
    Hello,
    Measure,
    Ready,
    Restore,
    Stop,
    ToWorker,
    Update,
    Welcome,
)
from workers.core import Core
from workers.envs import env_hash, exactness, make_env, spaces_of
from workers.failures import EnvironmentFailedError
from workers.heart import Heart, beat
from workers.numerics import fingerprint, versions
from workers.worker import OutOfStepError, Worker

log = logging.getLogger("worker")
_FIRST_WAIT, _LONGEST_WAIT = 0.1, 2.0
_SHORT_SECONDS = 1.0
"""A membership that was as short as this is followed by a pause."""
_REMARK_SECONDS = 10.0


class LearnerAbsentError(DppoError):
    """No learner answered within the time that the user gave."""


def wait_for(
    connect: Callable[[], WorkerLink | None], address: str, patience: float
) -> WorkerLink:
    """Try to connect until somebody listens.

    Raises:
        LearnerAbsentError: nobody did for `patience` seconds.
    """
    backoff, begun, remarked = Backoff(_FIRST_WAIT, _LONGEST_WAIT), time.monotonic(), 0.0
    while (link := connect()) is None:
        waited = time.monotonic() - begun
        if waited > patience:
            raise LearnerAbsentError(
                f"no learner answered at {address} for {patience:g} s; is it running, and is the "
                "address right?"
            )
        if remarked == 0.0 or waited - remarked > _REMARK_SECONDS:
            log.info("waiting for a learner at %s (%.0f s so far)", address, waited)
            remarked = max(waited, 0.001)
        time.sleep(backoff.next())
    return link


class Member:
    """One worker process on one link."""

    def __init__(
        self, name: str, link: WorkerLink, patience: float, core: Core | None = None
    ) -> None:
        self._name, self._link, self._patience = name, link, patience
        self._core = core or Core()
        self._numerics, self._versions = fingerprint(), versions()
        self._worker: Worker | None = None
        self._served: dict[str, int] = {}
        """Of each run, the highest generation that this process has served."""
        self._run = ""
        """The run that asked last."""

    def live(self) -> Stop:
        """Join and work, again and again, until a learner says that the run is over."""
        pauses = Backoff(_FIRST_WAIT, _LONGEST_WAIT)
        while True:
            welcome = self._join()
            if isinstance(welcome, Stop):
                return welcome
            joined = time.monotonic()
            self._served[welcome.run] = welcome.generation
            log.info("joined run %s (generation %d)", welcome.name, welcome.generation)
            stop = self._serve(welcome)
            if self._worker is not None:
                self._worker.close()
                self._worker = None
            if stop is not None and stop.final:
                return stop
            log.info("%s; waiting for the next learner", stop.reason if stop else "learner lost")
            if time.monotonic() - joined > _SHORT_SECONDS:
                pauses.again()
            else:  # something is wrong with the link or with us: do not keep the learner busy
                time.sleep(pauses.next())

    def _join(self) -> Welcome | Stop:
        """Say Hello until a Welcome comes, or the word that the run is over."""
        backoff, begun = Backoff(_FIRST_WAIT, _LONGEST_WAIT), time.monotonic()
        remarked = begun
        while True:
            self._link.send(self._hello())
            until = time.monotonic() + max(backoff.next(), _FIRST_WAIT)
            while (left := until - time.monotonic()) > 0:
                message = self._link.receive(left)
                if isinstance(message, Welcome) and self._is_of_the_past(message):
                    continue  # the next Hello tells it
                if isinstance(message, Welcome) or (isinstance(message, Stop) and message.final):
                    return message
            if time.monotonic() - remarked > _REMARK_SECONDS:
                remarked = time.monotonic()
                log.info("waiting for a learner's Welcome, for %.0f s", remarked - begun)
            if time.monotonic() - begun > self._patience:
                raise LearnerAbsentError(
                    f"the learner did not answer worker {self._name} for {self._patience:g} s; "
                    "look into its log"
                )

    def _hello(self) -> Hello:
        return Hello(
            worker=self._name,
            host=socket.gethostname(),
            pid=os.getpid(),
            numerics=self._numerics,
            versions=self._versions,
            served_run=self._run,
            served_generation=self._served.get(self._run, 0),
        )

    def _is_of_the_past(self, welcome: Welcome) -> bool:
        """Has this process served a later learner of the run? Then this one has to stop."""
        self._run = welcome.run
        served = self._served.get(welcome.run, 0)
        if welcome.generation >= served:
            return False
        log.warning(
            "ignored the learner of run %s, generation %d: generation %d has gone on with it",
            welcome.name,
            welcome.generation,
            served,
        )
        return True

    def _serve(self, welcome: Welcome) -> Stop | None:
        """Everything from Welcome to the end of this membership; None: the learner is lost."""
        heart = Heart(self._name, welcome.generation, self._link.send)
        try:
            worker = self._prepare(welcome)
            heart.begin()
            return self._work(worker, welcome.generation)
        except OutOfStepError as error:
            log.info("%s; joining anew", error)
            return None
        except (EnvironmentFailedError, UsageError) as error:
            failure = Failure(
                worker=self._name,
                generation=welcome.generation,
                usage=isinstance(error, UsageError),
                slot=error.slot if isinstance(error, EnvironmentFailedError) else -1,
                reason=str(error),
            )
            self._link.send(failure)
            heart.begin()  # if the failure is lost, signs of life of a stranger are answered
            return self._wait_for_stop(failure.reason)
        finally:
            heart.end()

    def _work(self, worker: Worker, generation: int) -> Stop | None:
        """Do what the learner asks until it says stop; None: it is lost."""
        while True:
            soon = self._core.awake(lambda: self._link.receive(0.0))
            message = soon or self._link.receive(60.0)
            match message:
                case Restore() | Collect() | Update() | Measure():
                    if message.generation == generation:
                        beat()
                        with self._core:
                            worker.perform(message)
                case Stop():
                    return message
                case LearnerLost():
                    return None
                case Refused():
                    log.warning("ignored a message: %s", message.reason)

    def _prepare(self, welcome: Welcome) -> Worker:
        """Build the environment once, to see that it works here and how large it is."""
        try:
            config = Config.from_dict(json.loads(welcome.config))
        except ValueError as error:
            raise UsageError(
                f"the learner's settings are not those of this version: {error}; install the same "
                "dppo version on learner and workers"
            ) from error
        self._core.release()
        env = make_env(config.run)
        spaces = spaces_of(env)
        self._worker = Worker(self._name, self._link, spaces, config, self._core)
        ready = Ready(
            worker=self._name,
            generation=welcome.generation,
            obs_size=spaces.obs_size,
            action_kind=spaces.action_kind,
            action_sizes=spaces.action_sizes,
            env_hash=env_hash(env),
            exact=exactness(env, config.rollout.exact_envs),
        )
        env.close()
        self._link.send(ready)
        return self._worker

    def _wait_for_stop(self, reason: str) -> Stop | None:
        """After a failure: the learner decides."""
        log.info("%s", reason)
        message: ToWorker | LearnerLost | Refused | None = None
        while not isinstance(message, Stop | LearnerLost):
            message = self._link.receive(60.0)
        return message if isinstance(message, Stop) else None
