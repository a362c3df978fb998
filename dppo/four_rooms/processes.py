"""Trials spread over processes: the same numbers as in one process, sooner."""

from collections.abc import Generator, Sequence
from dataclasses import asdict, fields
from typing import Any

from dppo.children import Answer, Arrays, Parent, answers, children
from dppo.errors import RunFailedError
from dppo.four_rooms.agent import Outcome, Progress, Trial, learn
from dppo.four_rooms.settings import AgentConfig
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
    shares = [trials[job::jobs] for job in range(jobs)]
    tasks = [_task(world, share, episodes, seed) for share in shares]
    with children("dppo.four_rooms.trial_process", tasks) as started:
        try:
            for answer in answers(started):
                yield _event(answer, shares[answer.child])
        except EOFError:
            raise RunFailedError(
                "a process of the experiment has died, perhaps for lack of memory; try fewer "
                "--jobs"
            ) from None


def serve(parent: Parent) -> None:
    """The child's side: learn what the task says."""
    task = parent.task
    agents = [AgentConfig(**agent) for agent in task["agents"]]
    trials = [Trial(agents[agent], number) for agent, number in task["trials"]]
    places = {trial: place for place, trial in enumerate(trials)}
    world = World(WorldConfig(**task["world"]))
    for event in learn(world, trials, episodes=task["episodes"], seed=task["seed"]):
        match event:
            case Progress():
                parent.answer({"episodes": event.episodes})
            case Outcome():
                parent.answer({"trial": places[event.trial]}, _arrays(event))
    parent.finish()


def _task(world: WorldConfig, trials: Sequence[Trial], episodes: int, seed: int) -> dict[str, Any]:
    """What one process has to learn; JSON gives the same numbers back, to the last bit."""
    agents = list(dict.fromkeys(trial.agent for trial in trials))
    places = {agent: place for place, agent in enumerate(agents)}
    return {
        "world": asdict(world),
        "agents": [asdict(agent) for agent in agents],
        "trials": [(places[trial.agent], trial.number) for trial in trials],
        "episodes": episodes,
        "seed": seed,
    }


def _arrays(outcome: Outcome) -> Arrays:
    """All but the trial."""
    names = (field.name for field in fields(Outcome) if field.name != "trial")
    return {name: getattr(outcome, name) for name in names}


def _event(answer: Answer, trials: Sequence[Trial]) -> Outcome | Progress:
    """What `learn` has said in the process that has these trials."""
    if "trial" in answer.facts:
        return Outcome(trial=trials[answer.facts["trial"]], **answer.arrays)
    return Progress(answer.facts["episodes"])
