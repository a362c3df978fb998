"""Load the policy that a run has left and play one episode with it.

    dppo-learner --env InvertedPendulum-v5 --total-timesteps 50000 --run-dir runs/pendulum
    python examples/load_a_policy.py runs/pendulum

A checkpoint's folder in the run will do, too.
`dppo eval RUN` does the same for many episodes and prints mean, spread and tail.
"""

import sys

import numpy as np

from dppo.errors import UsageError
from dppo.store.contents import chosen, config_in
from workers.envs import Adapter, make_env, quiet, spaces_of
from workers.policy import FrozenPolicy


def main(run: str) -> None:
    quiet()
    path, checkpoint = chosen(run, "best")  # verifies its checksums

    env = make_env(config_in(checkpoint).run)
    policy = FrozenPolicy(checkpoint, spaces_of(env))
    adapter = Adapter(env.observation_space, env.action_space)
    print(f"{path.name} of {run}: trained for {checkpoint.facts['env_steps']} steps")

    observation, _ = env.reset(seed=0)
    outlook = policy.outlook(adapter.obs(observation)[None], np.zeros(1, np.int64))
    spread = "" if outlook.std is None else f" ± {outlook.std[0]:.1f}"
    print(f"expected: discounted return {outlook.value[0]:.1f}{spread}")
    score, steps, over = 0.0, 0, False
    while not over:
        # without a generator: the most likely action; with one: a sampled action
        action = policy.act(adapter.obs(observation), steps, None)
        observation, reward, terminated, truncated, _ = env.step(adapter.to_env(action))
        score, steps, over = score + float(reward), steps + 1, terminated or truncated
    print(f"one episode: {steps} steps, return {score:.1f}")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python examples/load_a_policy.py RUN_DIRECTORY")
    try:
        main(sys.argv[1])
    except UsageError as error:  # one sentence: what is wrong, what was expected, what to do
        sys.exit(f"error: {error}")
