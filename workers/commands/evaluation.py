"""`dppo eval`: what a run's policy earns, how far that spreads, and whether σ knows."""

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from dppo.arguments import RunFolder
from dppo.config import RunConfig, require_seed
from dppo.settings import require

if TYPE_CHECKING:
    from workers.calibration import Calibration
    from workers.policy import FrozenPolicy


@dataclass(frozen=True, kw_only=True)
class EvalArgs:
    """Evaluate a run's policy: mean, spread and tail of its returns, with 95 % intervals."""

    run: RunFolder
    """Run directory, or one checkpoint folder in it."""
    episodes: int = 20
    """Episodes, each from its own start state; with --fixed-start as many again [count]."""
    fixed_start: bool = False
    """Also play episodes that share one start state and differ in all noise after it."""
    starts: int = 1
    """Start states to share, --episodes from each, summed up together [count]."""
    calibration: bool = False
    """Also compare the run's sigma with the spread of returns from one start state."""
    deterministic: bool = False
    """Take the most likely action instead of sampling."""
    env: str = ""
    """Another environment than the run's, of the same sizes: is the policy good there, too?"""
    env_kwargs: str = ""
    """Its keyword arguments, as JSON; by default the run's, or in another environment none."""
    which: str = "best"
    """best, newest, or a checkpoint's name such as iteration-00000040."""
    seed: int = 0
    """Of start states, actions, the environment's own noise and the intervals."""
    rows: int = 16
    """Environments side by side; only the speed depends on it [count]."""
    max_steps: int = 0
    """Cut each episode after so many steps, as a time limit does; 0: as the environment says."""
    json: bool = False
    """Print JSON with every episode."""

    def __post_init__(self) -> None:
        """Refuse what cannot be run."""
        for name in ("episodes", "starts", "rows"):
            require(getattr(self, name) >= 1, name, getattr(self, name), ">= 1")
        require(
            not (self.calibration and self.deterministic),
            "deterministic",
            self.deterministic,
            "off with --calibration: sigma is of the policy that samples",
        )
        require(
            not self.calibration or self.episodes >= 2,
            "episodes",
            self.episodes,
            ">= 2 with --calibration",
        )
        RunConfig(env_kwargs=self.env_kwargs or "{}")  # refuses what is no JSON object
        require(
            not (self.calibration and (self.env or self.env_kwargs)),
            "env" if self.env else "env_kwargs",
            self.env or repr(self.env_kwargs),
            "nothing with --calibration: sigma is of the returns in the run's environment",
        )
        require(self.max_steps >= 0, "max_steps", self.max_steps, ">= 0")
        require_seed(self.seed)


def run(args: EvalArgs) -> int:
    """Play, and print."""
    from dppo.store.contents import chosen, config_in
    from workers.calibration import Calibrator
    from workers.envs import quiet
    from workers.evaluate import evaluate, policy_of

    quiet()
    path, checkpoint = chosen(args.run, args.which)
    policy = policy_of(checkpoint, args.env, args.env_kwargs)
    calibrator = Calibrator(policy, args.max_steps) if args.calibration else None
    result = evaluate(
        policy,
        episodes=args.episodes,
        deterministic=args.deterministic,
        seed=args.seed,
        places=args.starts if args.fixed_start or args.calibration else 0,
        rows=args.rows,
        max_steps=args.max_steps,
        watch=None if calibrator is None else calibrator.note,
    )
    calibration = None if calibrator is None else calibrator.result(args.seed)
    facts: dict[str, Any] = {
        "env": policy.config.run.env,
        "env_kwargs": policy.config.run.env_kwargs,
        "checkpoint": path.name,
        "env_steps": checkpoint.facts["env_steps"],
        "actions": "most likely" if args.deterministic else "sampled",
        "action_std": policy.action_std,
        "gamma": policy.config.returns.gamma,
        "seed": args.seed,
    }
    if args.max_steps:
        facts["max_steps"] = args.max_steps
    if args.json:
        if calibration is not None:
            facts["calibration"] = calibration.to_dict()
        print(json.dumps(facts | result.to_dict(), indent=2))
        return 0
    cut = f", episodes cut after {args.max_steps} steps" if args.max_steps else ""
    print(
        f"{_where(policy, config_in(checkpoint).run)}, {path.name}, {facts['env_steps']:,} steps, "
        f"{facts['actions']} actions, gamma {facts['gamma']:g}{cut}"
    )
    for line in result.lines() + ([] if calibration is None else _table(calibration)):
        print(line)
    return 0


def _where(policy: "FrozenPolicy", trained: RunConfig) -> str:
    """The environment, and the run's if it is another one."""
    here = policy.config.run
    if here == trained:
        return here.env
    one, other = (
        run.env + ("" if run.env_kwargs == "{}" else f" {run.env_kwargs}")
        for run in (here, trained)
    )
    return f"{one} (trained on {other})"


def _table(calibration: "Calibration") -> list[str]:
    """Predicted beside empirical."""
    lines = [
        f"standard deviation of the lambda-return (gamma {calibration.gamma:g}, lambda_ret "
        f"{calibration.lambda_ret:g}) [reward]: predicted by sigma, and empirical",
        "  start  predicted  empirical  [95 % interval]        ratio  [95 % interval]",
    ]
    lines += [
        f"  {start.place:<5}  {start.predicted_std:<9.4g}  {start.empirical_std:<9.4g}  "
        f"{_bounds(start.empirical_std_interval):21}  {_ratio(start.ratio):<5}  "
        f"{_bounds(start.ratio_interval)}"
        for start in calibration.starts
    ]
    lines.append(
        f"  all starts: ratio {_ratio(calibration.ratio)} {_bounds(calibration.ratio_interval)}"
    )
    if not calibration.bins:
        return lines
    lines.append(
        f"  along the trajectories, with V's error: ratio {_ratio(calibration.along_ratio)} "
        f"{_bounds(calibration.along_ratio_interval)}"
    )
    lines.append("  tenths of the steps by sigma:  predicted  empirical")
    return lines + [
        f"  {number:<29}  {part.predicted_std:<9.4g}  {part.empirical_std:<9.4g}"
        for number, part in enumerate(calibration.bins, 1)
    ]


def _ratio(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"


def _bounds(interval: tuple[float, float] | None) -> str:
    return "-" if interval is None else f"[{interval[0]:.4g}, {interval[1]:.4g}]"
