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
    """Fingerprint of the first worker's floating point, and its libraries."""

    def greet(self, hello: Hello) -> None:
        """Note a worker; warn if its floating point or its libraries are not the first one's."""
        numerics = f"{hello.numerics}, {hello.versions}"
        self.numerics = self.numerics or numerics
        if numerics != self.numerics:
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
            return ""
        return (
            f"{self.describe(ready.worker)} has another environment than {first.worker}: "
            f"{spaces_in(ready)}, XML {ready.env_hash[:8]}, {ready.exact}; expected "
            f"{spaces_in(first)}, XML {first.env_hash[:8]}, {first.exact}; install the same "
            "versions of gymnasium and mujoco"
        )

    def forget(self, worker: str) -> None:
        """The worker is gone."""
        self._hellos.pop(worker, None)

    def describe(self, worker: str) -> str:
        """A worker in words: name, host, process."""
        hello = self._hellos.get(worker)
        return f"worker {worker}" + (f" ({hello.host}, pid {hello.pid})" if hello else "")

    def __contains__(self, worker: str) -> bool:
        return worker in self._hellos

    def __iter__(self) -> Iterator[str]:
        return iter(tuple(self._hellos))


def spaces_in(ready: Ready) -> Spaces:
    """The sizes in a worker's report."""
    return Spaces(
        obs_size=ready.obs_size,
        action_kind="box" if ready.action_kind == "box" else "discrete",
        action_sizes=ready.action_sizes,
    )
