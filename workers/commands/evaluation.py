"""`dppo eval`: what a run's policy earns, how far that spreads, and whether σ knows."""

from dataclasses import dataclass
from typing import Any

from dppo.settings import require


@dataclass(frozen=True, kw_only=True)
class EvalArgs:
    """Evaluate a run's policy: mean, spread and tail of its returns, with 95 % intervals."""

    run: str
    """Run directory, or one checkpoint folder in it."""
    episodes: int = 20
    """Episodes, each from its own start state; with --fixed-start as many again [count]."""
    fixed_start: bool = False
    """Also play episodes that share one start state and differ in all noise after it."""
    starts: int = 1
    """Start states to share, --episodes from each, summed up together [count]."""
    deterministic: bool = False
    """Take the most likely action instead of sampling."""
    which: str = "best"
    """best, newest, or a checkpoint's name such as iteration-00000040."""
    seed: int = 0
    """Of start states, actions, the environment's own noise and the intervals."""
    rows: int = 16
    """Environments side by side; only the speed depends on it [count]."""
    json: bool = False
    """Print JSON with every episode."""

    def __post_init__(self) -> None:
        """Refuse what cannot be run."""
        for name in ("episodes", "starts", "rows"):
            require(getattr(self, name) >= 1, name, getattr(self, name), ">= 1")
        require(0 <= self.seed < 2**63, "seed", self.seed, "0 <= seed < 2**63")


def run(args: EvalArgs) -> int:
    """Play, and print."""
    from dppo.store.contents import chosen
    from workers.envs import quiet
    from workers.evaluate import evaluate

    quiet()
    path, checkpoint = chosen(args.run, args.which)
    result = evaluate(
        checkpoint,
        episodes=args.episodes,
        deterministic=args.deterministic,
        seed=args.seed,
        places=args.starts if args.fixed_start else 0,
        rows=args.rows,
    )
    facts: dict[str, Any] = {
        "env": checkpoint.facts["config"]["run"]["env"],
        "checkpoint": path.name,
        "env_steps": checkpoint.facts["env_steps"],
        "actions": "most likely" if args.deterministic else "sampled",
        "gamma": checkpoint.facts["config"]["returns"]["gamma"],
        "seed": args.seed,
    }
    if args.json:
        print(result.to_json(facts))
        return 0
    print(
        f"{facts['env']}, {path.name}, {facts['env_steps']:,} steps, {facts['actions']} actions, "
        f"gamma {facts['gamma']:g}"
    )
    for line in result.lines():
        print(line)
    return 0
