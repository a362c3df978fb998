"""Trials spread over processes: the same numbers as in one process, sooner."""

import multiprocessing
import signal
from collections.abc import Generator, Sequence
from contextlib import suppress
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess

from dppo.errors import RunFailedError
from dppo.four_rooms.agent import Outcome, Progress, Trial, learn
from dppo.four_rooms.world import World, WorldConfig


def learn_on_cores(
    world: WorldConfig, trials: Sequence[Trial], *, episodes: int, seed: int, jobs: int
) -> Generator[Outcome | Progress, None, None]:
    """`learn`, in `jobs` processes; they end when this generator is closed.

    Neighbouring trials go to different processes, so that each gets its share of every arm.

    Raises:
        RunFailedError: a process has died.
    """
    jobs = min(jobs, len(trials))
    if jobs == 1:
        yield from learn(World(world), trials, episodes=episodes, seed=seed)
        return
    running = [_start(world, trials[job::jobs], episodes, seed) for job in range(jobs)]
    pipes = [pipe for _, pipe in running]
    try:
        while pipes:
            ready = wait(pipes)
            for pipe in [pipe for pipe in pipes if pipe in ready]:
                event = _received(pipe)
                if event is None:
                    pipes.remove(pipe)
                else:
                    yield event
    finally:
        for process, pipe in running:
            process.terminate()
            process.join()
            pipe.close()


def _received(pipe: Connection) -> Outcome | Progress | None:
    """What a process has sent; None: it has finished."""
    try:
        event: Outcome | Progress | None = pipe.recv()
    except EOFError:
        raise RunFailedError(
            "a process of the experiment has died, perhaps for lack of memory; try fewer --jobs"
        ) from None
    return event


def _start(
    world: WorldConfig, trials: Sequence[Trial], episodes: int, seed: int
) -> tuple[BaseProcess, Connection]:
    """One process, deaf to Ctrl-C from its first moment: the parent ends it."""
    context = multiprocessing.get_context("spawn")
    pipe, theirs = context.Pipe(duplex=False)
    process = context.Process(
        target=_work, args=(theirs, world, trials, episodes, seed), daemon=True
    )
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)  # a child inherits what is ignored
    process.start()
    signal.signal(signal.SIGINT, before)
    theirs.close()
    return process, pipe


def _work(
    pipe: Connection, world: WorldConfig, trials: Sequence[Trial], episodes: int, seed: int
) -> None:
    with suppress(BrokenPipeError):  # nobody is left to be told
        for event in learn(World(world), trials, episodes=episodes, seed=seed):
            pipe.send(event)
        pipe.send(None)
