"""MuJoCo tasks where it pays to be careful: actions that tremble, and gambles above a threshold.

    HopperActionNoise-v4    noise of std 0.1 (of half the control range) is added to each action
    HopperRiskySpeed-v4     forward speed above a threshold also pays +10 or -10, evens
    HopperRiskyAngle-v4     the same for a torso that leans beyond a threshold

For HalfCheetah, Hopper, Walker2d and Ant (which has no one angle), on Gymnasium's -v4 and -v5. A
gamble has mean 0: it leaves every policy's expected return as it is and only adds variance, so
that what a penalty on variance gains can be told from what it gives up. Keyword arguments:
`noise_std`, `risk`, `threshold`, `over`, and those of the Gymnasium class.

    gymnasium.make("workers.hazards:HopperRiskySpeed-v4", threshold=2.0, risk=5)

The name before the colon imports this module, which registers them. `dppo-learner` needs no such
name.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import gymnasium
import numpy as np
from gymnasium.envs.registration import load_env_creator
from numpy.typing import NDArray

Float64 = NDArray[np.float64]
Env = gymnasium.Env[Any, Any]
_NOISE_STD = 0.1
_RISK = 10.0
_SPEED = {"HalfCheetah": 4.0, "Hopper": 2.5, "Walker2d": 3.0, "Ant": 1.5}
"""[m/s] about what trained policies run at."""
_ANGLE = {"HalfCheetah": 0.2, "Hopper": 0.05, "Walker2d": 0.2}
"""[rad] a part of what they lean by."""
_TORSO = 2
"""Where the angle of a planar torso lies in qpos."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Hazard:
    """What is added to a task. Draws come from the environment's own generator."""

    noise_std: float = 0.0
    """Std of the noise on actions [half the control range]; 0: none."""
    risk: float = 0.0
    """What a step beyond the threshold wins or loses, evens [reward]; 0: nothing."""
    threshold: float = 0.0
    """[m/s] forward, or [rad] either way."""
    over: Literal["speed", "angle"] = "speed"
    """What the threshold is for."""

    def __post_init__(self) -> None:
        """Refuse what cannot be run."""
        for name in ("noise_std", "risk"):
            value = getattr(self, name)
            if not 0 <= value < np.inf:
                raise ValueError(f"{name} is {value}, expected a finite number >= 0")
        if self.over not in ("speed", "angle"):
            raise ValueError(f"over is {self.over!r}, expected 'speed' or 'angle'")

    def disturbed(
        self, action: NDArray[Any], noise: Float64, space: gymnasium.spaces.Box
    ) -> NDArray[Any]:
        """Actions [..., A] with standard normal noise [..., A], scaled, within the bounds."""
        half = (space.high.astype(np.float64) - space.low) / 2
        noisy = np.minimum(
            np.maximum(action + self.noise_std * half * noise, space.low), space.high
        )
        return noisy.astype(space.dtype)

    def gamble(self, rng: np.random.Generator) -> float:
        """+risk or -risk, evens."""
        return self.risk if rng.random() < 0.5 else -self.risk


class Hazardous(gymnasium.Wrapper[Any, Any, Any, Any]):
    """One environment with a hazard. It has no state besides the environment's generator."""

    def __init__(self, env: Env, hazard: Hazard) -> None:
        super().__init__(env)
        self.hazard = hazard
        if hazard.over == "angle" and type(env.unwrapped).__name__ == "AntEnv":
            raise ValueError("over is 'angle', expected 'speed': Ant's torso has no one angle")

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:  # noqa: ANN401
        """As the environment's, with noise before and a gamble after."""
        hazard, rng, space = self.hazard, self.unwrapped.np_random, self.env.action_space
        assert isinstance(space, gymnasium.spaces.Box)
        if hazard.noise_std > 0:
            action = hazard.disturbed(action, rng.standard_normal(space.shape), space)
        obs, reward, terminated, truncated, info = self.env.step(action)
        if hazard.risk > 0:
            beyond = self._measured(info) > hazard.threshold
            gamble = hazard.gamble(rng) if beyond else 0.0
            reward, info = float(reward) + gamble, info | {"gamble": gamble}
        return obs, float(reward), terminated, truncated, info

    def _measured(self, info: dict[str, Any]) -> float:
        if self.hazard.over == "speed":
            return float(info["x_velocity"])
        env: Any = self.unwrapped
        return abs(float(env.data.qpos[_TORSO]))


def hazard_of(env: Env) -> Hazard:
    """What was added to an environment; nothing, if it has no hazard."""
    wrapper: Any = env
    while isinstance(wrapper, gymnasium.Wrapper):
        if isinstance(wrapper, Hazardous):
            return wrapper.hazard
        wrapper = wrapper.env
    return Hazard()


def measured(
    hazard: Hazard, now: dict[str, Float64], info: Callable[[], dict[str, Any]]
) -> Float64:
    """[n] what the threshold is for, of n environments; see `workers.kinds`."""
    if hazard.over == "speed":
        return np.asarray(info()["x_velocity"], np.float64)
    return np.abs(now["qpos"][:, _TORSO])


def make(
    base: str,
    noise_std: float = 0.0,
    risk: float = 0.0,
    threshold: float = 0.0,
    over: Literal["speed", "angle"] = "speed",
    **kwargs: Any,  # noqa: ANN401  of the Gymnasium class
) -> Hazardous:
    """Gymnasium's `base` with a hazard, without the time limit that `gymnasium.make` adds."""
    creator: Any = gymnasium.spec(base).entry_point
    build: Any = load_env_creator(creator) if isinstance(creator, str) else creator
    hazard = Hazard(noise_std=noise_std, risk=risk, threshold=threshold, over=over)
    return Hazardous(build(**kwargs), hazard)


def ids() -> dict[str, dict[str, Any]]:
    """All ids, with their keyword arguments."""
    found: dict[str, dict[str, Any]] = {}
    for version in ("v4", "v5"):
        for name, speed in _SPEED.items():
            base = {"base": f"{name}-{version}"}
            found[f"{name}ActionNoise-{version}"] = base | {"noise_std": _NOISE_STD}
            risky = base | {"risk": _RISK, "threshold": speed}
            found[f"{name}RiskySpeed-{version}"] = risky | {"over": "speed"}
        for name, angle in _ANGLE.items():
            risky = {"base": f"{name}-{version}", "risk": _RISK, "threshold": angle}
            found[f"{name}RiskyAngle-{version}"] = risky | {"over": "angle"}
    return found


def register() -> None:
    """Make the environments known to Gymnasium; a second time changes nothing."""
    for name, kwargs in ids().items():
        if name not in gymnasium.registry:
            limit = gymnasium.spec(kwargs["base"]).max_episode_steps
            gymnasium.register(
                name, entry_point="workers.hazards:make", max_episode_steps=limit, kwargs=kwargs
            )


register()
