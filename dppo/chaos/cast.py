"""A learner, its external workers and their links, and what each kind of fault does to them.

Whoever ought to run and has ended is started again with the same command: the learner after a
fault that ends it, an external worker whatever ended it.
"""

import contextlib
import random
import signal
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from dppo.chaos.plan import LINK_KINDS, Fault
from dppo.chaos.processes import Child, Handle, children_of
from dppo.chaos.proxy import Proxy
from dppo.errors import RunFailedError, UsageError
from dppo.machine import free_port
from dppo.store.checkpoint import names
from dppo.store.reading import read_object


@dataclass(frozen=True, slots=True)
class Setup:
    """A run as it is started."""

    flags: tuple[str, ...]
    """The learner's, but for its folder, its address and its own workers."""
    local_workers: int
    workers: int
    """External ones."""


@dataclass(slots=True)
class _External:
    """An external worker's place: its link, and the process that is there now."""

    proxy: Proxy
    child: Child
    weather: list[Fault] = field(default_factory=list)
    """Faults of its link that last."""


class Cast:
    """Everybody who takes part in one run."""

    def __init__(self, setup: Setup, folder: Path, mark: str, seed: int) -> None:
        self._setup, self._folder, self._mark = setup, folder, mark
        self._dice = random.Random(seed)
        self.run_dir = folder / "run"
        self.port = free_port()
        self.externals: dict[str, _External] = {}
        self._undo: list[tuple[float, Callable[[], None]]] = []
        self._stopped: list[Handle] = []
        self._spawned = 0
        self._started: list[Child] = []
        """All that ever were, to be waited for."""
        self._asked = False
        """The learner's end was ordered: it is started again."""
        self.learner = self._start_learner()
        for index in range(setup.workers):
            self._join(f"w{index}")

    def is_over(self) -> bool:
        """The learner has finished the run, or as much as it should. One that was told to end is
        started again.

        Raises:
            RunFailedError: it has ended unasked, before the run was finished.
            UsageError: it refuses to begin the run.
        """
        if self.learner.running:
            return False
        code = self.learner.popen.returncode
        if code == 2 and not (self.run_dir / "config.json").exists():
            raise UsageError(f"the learner refuses the run: {self.learner.complaint()}")
        if read_object(self.run_dir / "result.json").get("status") == "finished":
            return True
        if not self._asked:
            if code == 0:  # --stop-at
                return True
            raise RunFailedError(
                f"the learner ended with exit code {code}, unasked; it said: "
                f"{self.learner.last_words()}"
            )
        self.learner = self._start_learner()
        return False

    def look_after(self, now: float) -> None:
        """End the faults whose time has come, and start external workers that have ended."""
        due = [undo for at, undo in self._undo if at <= now]
        self._undo = [(at, undo) for at, undo in self._undo if at > now]
        for undo in due:
            undo()
        for name, external in self.externals.items():
            if not external.child.running:
                external.child = self._start_worker(name, external.proxy)

    def inject(self, fault: Fault, now: float) -> str:
        """Let a fault happen; what became of it, if not what was planned."""
        if fault.fault in LINK_KINDS:
            return self._disturb_link(fault, now)
        if fault.target == "learner":
            return self._disturb_learner(fault, now)
        if fault.fault == "join-worker":
            return self._let_join(fault, now)
        victim = self._find(fault.target)
        if victim is None:
            return "was not there"
        if fault.fault == "stop-worker":
            self._stop(victim, fault.seconds, now)
        else:
            victim.send(signal.SIGKILL if fault.fault == "kill-worker" else signal.SIGTERM)
        return ""

    def calm(self) -> None:
        """No fault lasts any longer; whoever was stopped for ever is killed."""
        for external in self.externals.values():
            external.weather.clear()
            external.proxy.set(())
        for handle in self._stopped:
            handle.send(signal.SIGKILL)
        for _, undo in self._undo:
            undo()
        self._undo.clear()

    def local_workers(self) -> list[Handle]:
        """The learner's own workers, oldest first."""
        return children_of(self.learner.pid)

    def close(self) -> None:
        """The links, and what is left of processes that have ended."""
        for external in self.externals.values():
            external.proxy.close()
        for child in self._started:
            child.popen.wait()

    def _disturb_link(self, fault: Fault, now: float) -> str:
        external = self.externals[fault.target]
        if fault.fault == "disconnect":
            stood = external.proxy.connections
            external.proxy.cut()
            return "" if stood else "was not connected"

        def apply() -> None:
            external.proxy.set({one.fault for one in external.weather})

        def clear() -> None:
            with contextlib.suppress(ValueError):  # calm came first
                external.weather.remove(fault)
            apply()

        external.weather.append(fault)
        apply()
        self._undo.append((now + fault.seconds, clear))
        return ""

    def _disturb_learner(self, fault: Fault, now: float) -> str:
        learner, said = self.learner, ""
        match fault.fault:
            case "stop-learner":
                handle = Handle.of(learner.pid)
                if handle is not None:
                    self._stop(handle, fault.seconds, now)
            case "terminate-learner":
                self._asked = True
                learner.popen.send_signal(signal.SIGTERM)
            case _:
                self._asked = True
                learner.popen.kill()
                learner.popen.wait()
                if fault.fault == "corrupt-checkpoint":
                    said = self._corrupt_checkpoint()
                self.is_over()
        return said

    def _corrupt_checkpoint(self) -> str:
        """Turn over a bit of the newest checkpoint, if there is one before it to fall back to."""
        folder = self.run_dir / "checkpoints"
        found = names(folder)
        if len(found) < 2:
            return f"{len(found)} checkpoints there: killed the learner only"
        file = folder / found[-1] / self._dice.choice(["arrays.safetensors", "manifest.json"])
        data = bytearray(file.read_bytes())
        data[self._dice.randrange(len(data))] ^= 1 << self._dice.randrange(8)
        file.write_bytes(data)
        return ""

    def _let_join(self, fault: Fault, now: float) -> str:
        name = fault.target
        if name in self.externals:
            return "was there already"
        self._join(name)

        def leave() -> None:
            external = self.externals.pop(name)
            external.child.popen.send_signal(signal.SIGTERM)
            external.child.popen.send_signal(signal.SIGCONT)
            external.proxy.close()

        if fault.seconds:
            self._undo.append((now + fault.seconds, leave))
        return ""

    def _stop(self, victim: Handle, seconds: float, now: float) -> None:
        victim.send(signal.SIGSTOP)
        if seconds:
            self._undo.append((now + seconds, lambda: victim.send(signal.SIGCONT)))
        else:
            self._stopped.append(victim)

    def _find(self, target: str) -> Handle | None:
        """Who has that name now; None: nobody."""
        if target in self.externals:
            return Handle.of(self.externals[target].child.pid)
        index, local = int(target.removeprefix("local-")), self.local_workers()
        return local[index] if index < len(local) else None

    def _join(self, name: str) -> None:
        proxy = Proxy(self.port, self._dice.getrandbits(32))
        self.externals[name] = _External(proxy, self._start_worker(name, proxy))

    def _start_learner(self) -> Child:
        self._asked = False
        words = [
            "learner", *self._setup.flags,
            "--run-dir", str(self.run_dir),
            "--listen", f"tcp/127.0.0.1:{self.port}",
            "--local-workers", str(self._setup.local_workers),
        ]  # fmt: skip
        return self._start("learner", words)

    def _start_worker(self, name: str, proxy: Proxy) -> Child:
        self._spawned += 1  # a name is new for each process
        words = ["workers", "--connect", proxy.address, "--name", f"{name}-{self._spawned}"]
        return self._start(name, words)

    def _start(self, name: str, words: list[str]) -> Child:
        child = Child.start(name, words, self._folder, self._mark)
        self._started = [one for one in self._started if one.running]
        self._started.append(child)
        return child
