"""Who has said Hello, and whether they compute on the same thing in the same way."""

import logging
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

from dppo.spaces import Spaces
from dppo.wire.messages import Hello, Ready
from learner.soundness import odd_sizes

log = logging.getLogger("learner")


@dataclass(slots=True)
class Roster:
    """The workers that this learner talks to."""

    first: Ready | None = None
    """The first worker's report of the environment; all others must agree."""
    _hellos: dict[str, Hello] = field(default_factory=dict)
    numerics: str = ""
    """Fingerprint of the first worker's floating point, its code and libraries."""
    code: str = ""
    """The learner's own; empty: not compared."""
    exact: bool = True
    """No worker of the run computes otherwise than the first, or has other code."""
    _others: set[str] = field(default_factory=set)

    def greet(self, hello: Hello) -> None:
        """Note a worker; warn if its floating point, libraries or code are not what they were."""
        numerics = f"{hello.numerics}, {hello.versions}"
        self.numerics = self.numerics or numerics
        if self.code and f"code {self.code}," not in hello.versions:
            self._others.add(hello.worker)
            log.warning(
                "worker %s on %s has other code (%s) than the learner (code %s): what it computes "
                "may be wrong, and the run is not exact; install the same version",
                hello.worker,
                hello.host,
                hello.versions,
                self.code,
            )
        elif numerics != self.numerics:
            self._others.add(hello.worker)
            log.warning(
                "worker %s on %s computes with (%s), the first worker with (%s): do not expect "
                "the same bits as on one kind of machine",
                hello.worker,
                hello.host,
                numerics,
                self.numerics,
            )
        self._hellos[hello.worker] = hello

    def admit(self, ready: Ready) -> str:
        """Compare a worker's environment with the first one's; the objection, or empty."""
        if odd := odd_sizes(ready):
            return f"{self.describe(ready.worker)} {odd}"
        if self.first is None:
            self.first = ready
        first = self.first
        if replace(ready, worker=first.worker) == first:
            self.exact = self.exact and ready.worker not in self._others
            return ""
        return (
            f"{self.describe(ready.worker)} has another environment than {first.worker}: "
            f"{_in_words(ready)}; expected {_in_words(first)}; install the same versions of "
            "gymnasium, mujoco and the environment"
        )

    def forget(self, worker: str) -> None:
        """The worker is gone."""
        self._hellos.pop(worker, None)

    def describe(self, worker: str) -> str:
        """A worker in words; of one that has not said Hello only its name is known."""
        hello = self._hellos.get(worker)
        return introduced(hello) if hello else f"worker {worker}"

    def __contains__(self, worker: str) -> bool:
        return worker in self._hellos

    def __iter__(self) -> Iterator[str]:
        return iter(tuple(self._hellos))


def introduced(hello: Hello) -> str:
    """A worker in words: name, host, process."""
    return f"worker {hello.worker} ({hello.host}, pid {hello.pid})"


def _in_words(ready: Ready) -> str:
    xml = f", XML {ready.env_hash[:8]}" if ready.env_hash else ""
    return f"{spaces_in(ready)}{xml}, {ready.exact}"


def spaces_in(ready: Ready) -> Spaces:
    """The sizes in a worker's report."""
    return Spaces(
        obs_size=ready.obs_size,
        action_kind="box" if ready.action_kind == "box" else "discrete",
        action_sizes=ready.action_sizes,
    )
