"""Workers of the benchmarks on socket pairs, started and looked after as the learner does it."""

import sys
from collections.abc import Callable
from dataclasses import dataclass

from benchmarks.puppets import Puppet
from dppo.wire.links import LearnerLost, Refused, WorkerLink
from dppo.wire.socket_links import Alarm, SocketLearnerLink
from dppo.wire.zenoh_links import ZenohLearnerLink
from learner.local import LocalWorkers

Serve = Callable[[str, WorkerLink], None]


def learner_link(address: str) -> SocketLearnerLink:
    """The link of a learner that listens at `address` for workers that it has not started."""
    alarm = Alarm()
    return SocketLearnerLink(ZenohLearnerLink(address, alarm.ring), alarm)


@dataclass(slots=True)
class Pairs(LocalWorkers):
    """The learner's own `LocalWorkers` with another module in place of `workers`."""

    module: str = ""
    keeps_cores: bool = False
    """As the learner's own do; not where others that do not are measured beside them."""

    def wait(self) -> None:
        """Until all have ended by themselves."""
        for child in filter(None, self._children.values()):
            child.process.wait(timeout=60)

    def _command(self, name: str, core: int, *descriptors: str) -> list[str]:
        own = ("--core", str(core)) if self.keeps_cores else ()
        words = ("--name", name, *own, "--socket", *descriptors)
        return [sys.executable, "-m", self.module, *words]


def serve_puppet(name: str, link: WorkerLink, size: int) -> None:
    """Answer like a worker that has nothing to compute, until the learner is gone."""
    puppet = Puppet(name, size)
    link.send(puppet.hello())
    while not isinstance(message := link.receive(60.0), LearnerLost):
        if message is not None and not isinstance(message, Refused):
            for answer in puppet.answers(message):
                link.send(answer)
