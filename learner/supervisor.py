"""Starts the learner again when it dies: `dppo-learner --restarts N` becomes this program.

It loads nothing but the standard library, so it stays small beside what it guards. The learner is
its child, in a session of its own: Ctrl-C reaches it only from here. It is told this process's id
and stops by itself, with a checkpoint, when it has another parent: kill -9 leaves nothing behind.

A learner that ends with 0 (finished, stopped) is not started again, nor one whose first start ends
with 2 (wrong usage: it would end so again); one that a signal ended or that failed is, up to N
times in all. So is a restart that ends with 2: the usage was right, something else is in the way.
"""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, field

from dppo.backoff import Backoff
from dppo.machine import own_program
from dppo.process import say
from dppo.signals import Signals

_FIRST_PAUSE, _LONGEST_PAUSE = 0.5, 30.0
_LONG_LIFE = 60.0
"""After so many seconds of life a death is not of a series: the pauses begin anew."""


@dataclass(slots=True)
class Supervision:
    """What follows when a learner ends; knows no process and no clock."""

    restarts: int
    """N: restarts in all."""
    used: int = 0
    _backoff: Backoff = field(default_factory=lambda: Backoff(_FIRST_PAUSE, _LONGEST_PAUSE))

    def pause_after(self, code: int, lived: float) -> float | None:
        """Seconds until the next start, after exit code or minus signal; None: there is none."""
        if self._is_final(code) or self.used >= self.restarts:
            return None
        if lived >= _LONG_LIFE:
            self._backoff.again()
        self.used += 1
        return self._backoff.next()

    def _is_final(self, code: int) -> bool:
        return code == 0 or (code == 2 and self.used == 0)

    def sentence(self, code: int, lived: float, pause: float | None) -> str:
        """What happened, and what happens now; empty if the learner has said it itself."""
        how = f"was ended by {signal_name(-code)}" if code < 0 else f"ended with exit code {code}"
        what = f"the learner {how} after {lived:.1f} s"
        if pause is not None:
            left = self.restarts - self.used
            return (
                f"{what}; starting it again in {pause:.1f} s, restart {self.used} of "
                f"{self.restarts}, {left} left"
            )
        if self._is_final(code):
            return ""
        return (
            f"{what}; no restart is left of --restarts {self.restarts}: see above for the cause; "
            "the same command with this --run-dir continues"
        )


def signal_name(number: int) -> str:
    """SIGKILL for 9; `signal 40` for one without a name."""
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"


def exit_code(code: int) -> int:
    """As a shell says it: 128 + number for a signal."""
    return 128 - code if code < 0 else code


def supervise(command: Sequence[str], again: Sequence[str], restarts: int) -> int:
    """Run `command` until it is over, with `again` added when it is a restart; the exit code."""
    signals, supervision = Signals(), Supervision(restarts)
    while True:
        begun = time.monotonic()
        words = [*command, *(again if supervision.used else ())]
        code, asked = _start(words, signals)
        if asked:
            return exit_code(code)
        lived = time.monotonic() - begun
        pause = supervision.pause_after(code, lived)
        if sentence := supervision.sentence(code, lived, pause):
            say(f"supervisor: {sentence}", sys.stderr)
        if pause is None:
            return exit_code(code)
        if (number := signals.next_request(pause)) is not None:
            return 128 + number  # nothing runs, and nothing will


def _start(words: Sequence[str], signals: Signals) -> tuple[int, bool]:
    """As `_watch`; a machine that has no room for a process now has failed like a learner."""
    try:
        child = subprocess.Popen(words, stdin=subprocess.DEVNULL, start_new_session=True)
    except OSError as error:
        say(f"supervisor: the learner cannot be started: {error}", sys.stderr)
        return 1, False
    return _watch(child, signals)


def _watch(child: subprocess.Popen[bytes], signals: Signals) -> tuple[int, bool]:
    """Pass requests to end on; the child's exit code, or minus signal, and was there a request."""
    asked = False
    while (code := child.poll()) is None:
        number = signals.next(None)
        if number not in (signal.SIGTERM, signal.SIGINT):
            continue
        if asked:
            child.kill()
            child.wait()
            return -number, True
        asked = True
        child.send_signal(number)
    return code, asked


def main() -> None:
    """`python -m learner.supervisor N arguments of dppo-learner ...`: not for people."""
    restarts, arguments = int(sys.argv[1]), sys.argv[2:]
    command = own_program("learner", "--supervised", str(os.getpid()), *arguments)
    sys.exit(supervise(command, ["--resume", "auto"], restarts))


if __name__ == "__main__":
    main()
