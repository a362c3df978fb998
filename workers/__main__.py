"""`dppo-worker`: command line -> link -> member. Everything from outside is read here."""

import os
import sys
from dataclasses import dataclass

from dppo.settings import require


@dataclass(frozen=True, kw_only=True)
class WorkerArgs:
    """A worker: runs environments and computes gradients for the learner it connects to.

    It needs nothing but the address: environment, settings and slots come from the learner. It may
    be started before the learner, and it waits for the next one when the learner dies. --version
    says which code this is: it ought to be the learner's. Exit code 0: the run is over; 1: the
    learner has sent it away, and says why; 2: wrong usage, or nobody answered.
    """

    connect: str
    """Address of the learner, e.g. tcp/learner:7447."""
    name: str = ""
    """Name in logs: letters, digits, '-'; empty: the host's. A random part is added to it."""
    wait_seconds: float = float("inf")
    """Give up when no learner answers for so long [s]."""
    verbose: bool = True
    """Log joining, waiting and losing the learner."""

    def __post_init__(self) -> None:
        """Refuse what makes no sense."""
        require(self.wait_seconds >= 0, "wait_seconds", self.wait_seconds, ">= 0")


def main(argv: list[str] | None = None) -> None:
    """Run one worker process; the exit code says how it ended."""
    from dppo.machine import no_window, one_thread
    from dppo.process import leave

    one_thread()
    no_window()
    arguments = sys.argv[1:] if argv is None else argv
    if arguments[:1] == ["--socket"]:  # a child of the learner's: not for people
        leave(lambda: _serve_parent(arguments))
    leave(lambda: _work(arguments))


@dataclass(frozen=True, kw_only=True)
class _ChildArgs:
    """A worker that the learner has started itself."""

    socket: tuple[int, ...]
    """Descriptors of its end of the pair, and of the memory that both share."""
    name: str
    core: int = -1
    """Which of the usable cores it keeps to, if it can; -1: none."""
    verbose: bool = True


def _serve_parent(arguments: list[str]) -> int:
    from dppo.machine import end_with_parent
    from dppo.process import parse, start_logging
    from dppo.wire.socket_links import SocketWorkerLink
    from workers.core import Core
    from workers.envs import quiet
    from workers.membership import Member

    end_with_parent()
    args = parse(_ChildArgs, arguments, "dppo-worker")
    start_logging(args.verbose)
    link = SocketWorkerLink(args.socket, orphaned=lambda: os._exit(0))
    quiet()
    Member(args.name, link, float("inf"), Core(args.core)).live()
    return 0


def _work(arguments: list[str]) -> int:
    from functools import partial

    from dppo.process import parse, start_logging

    args = parse(WorkerArgs, arguments, "dppo-worker")  # before what takes long to load
    start_logging(args.verbose)
    from dppo.errors import UsageError
    from dppo.wire.zenoh_links import ZenohWorkerLink, open_connecting
    from workers.envs import quiet
    from workers.membership import LearnerAbsentError, Member, wait_for

    name = _unique_name(args.name)
    quiet()

    reopen = partial(open_connecting, args.connect)

    def connect() -> ZenohWorkerLink | None:
        session = reopen()
        return None if session is None else ZenohWorkerLink(session, name, reopen)

    try:
        link = wait_for(connect, args.connect, args.wait_seconds)
        stop = Member(name, link, args.wait_seconds).live()
    except LearnerAbsentError as error:
        raise UsageError(str(error)) from error
    print(f"worker {name}: {stop.reason}", file=sys.stderr)
    link.close()
    return int(stop.sent_away)


def _unique_name(wanted: str) -> str:
    """The wanted name, or the host's, with a random part: no two processes share it.

    Raises:
        UsageError: it cannot be part of a key.
    """
    import re
    import secrets
    import socket

    from dppo.errors import UsageError

    if re.fullmatch("[A-Za-z0-9-]{0,57}", wanted) is None:  # 64 with the random part
        raise UsageError(
            f"--name is {wanted!r}, expected at most 57 of the letters A to Z, digits and '-'"
        )
    host = re.sub("[^A-Za-z0-9]", "-", socket.gethostname())[:20]
    return f"{wanted or host}-{secrets.token_hex(3)}"


if __name__ == "__main__":
    main()
