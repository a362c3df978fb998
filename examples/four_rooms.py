"""What the penalty is worth on Four Rooms: the exact optimum, and a few trials of Algorithm 1.

    python examples/four_rooms.py           10 trials of each agent, some seconds

`dppo four-rooms` runs 50 trials of 4000 episodes and draws the figures.
"""

import sys

import numpy as np

from dppo.four_rooms.agent import Outcome, Trial, learn
from dppo.four_rooms.optimum import best
from dppo.four_rooms.oracle import evaluate
from dppo.four_rooms.settings import AgentConfig
from dppo.four_rooms.world import World

PLAIN, SAFE = AgentConfig(psi=0.0, alpha_critic=0.1), AgentConfig(psi=0.25)
EPISODES = 500


def main(trials: int) -> None:
    world = World()
    start = world.mdp.start
    print("optimum    E[V]   E[sigma]")
    for agent in (PLAIN, SAFE):
        settings = {"gamma": agent.gamma, "lambda_ret": agent.lambda_ret}
        policy = best(world.mdp, psi=agent.psi, **settings).policy
        exact = evaluate(world.mdp, policy, **settings)
        print(f"psi {agent.psi:<4g} {start @ exact.v:7.2f} {start @ exact.sigma:10.2f}")

    batch = [Trial(agent, number) for agent in (PLAIN, SAFE) for number in range(trials)]
    found = [
        event
        for event in learn(world, batch, episodes=EPISODES, seed=0)
        if isinstance(event, Outcome)
    ]
    print(f"learned   return   frozen steps per episode, last 100 of {EPISODES} episodes")
    for agent in (PLAIN, SAFE):
        arm = [one for one in found if one.trial.agent == agent]
        returns = np.mean([one.returns[-100:] for one in arm])
        frozen = np.mean([one.frozen[-100:] for one in arm])
        print(f"psi {agent.psi:<4g} {returns:8.2f} {frozen:8.2f}")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 10)
