"""A whole run in one process: the chief, and workers as threads, joined by queues.

    python examples/one_process.py          two workers
    python examples/one_process.py 3        three workers, and the same hash

Nothing is written to the disk. `dppo-learner` does the same with processes and sockets.
"""

import json
import os
import sys
import threading

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # read once, when NumPy is imported

from dppo.config import Config, RolloutConfig, RunConfig, UpdateConfig
from dppo.leases import Leases
from dppo.networks import Networks
from dppo.store.checkpoint import sha256
from dppo.wire.memory_links import MemoryHub
from dppo.wire.messages import Welcome
from learner.chief import Chief
from learner.exchange import Exchange
from learner.ledger import Ledger
from learner.soundness import Expected
from learner.state import State
from workers.envs import quiet
from workers.membership import Member

CONFIG = Config(
    run=RunConfig(env="InvertedPendulum-v5", total_timesteps=12_000),
    rollout=RolloutConfig(slots=4, num_envs=2, num_steps=128),
    update=UpdateConfig(update_epochs=4),
)


def main(num_workers: int) -> None:
    quiet()
    hub = MemoryHub()
    for name in (f"thread-{number}" for number in range(num_workers)):
        member = Member(name, hub.worker(name), patience=30.0)
        threading.Thread(target=member.live, daemon=True).start()

    welcome = Welcome(run="example", generation=1, config=json.dumps(CONFIG.to_dict()))
    leases = Leases(CONFIG.rollout.slots)
    exchange = Exchange(hub.learner(), welcome, leases, lambda: None)
    spaces = exchange.wait_for_environment()  # a worker built it; the chief never sees it
    networks = Networks.build(spaces, CONFIG)
    exchange.expected = Expected(spaces, networks.size, CONFIG.rollout.samples_per_slot)
    state = State.initial(networks, spaces.obs_size, CONFIG)
    chief = Chief(state, networks, CONFIG, 1, exchange, Ledger(CONFIG.rollout, lambda _: None))
    while chief.state.iteration < CONFIG.iterations:
        report = chief.iterate().report()
        mean, kl = (report.metrics.get(name, 0.0) for name in ("rollout/ep_rew_mean", "train/kl"))
        print(f"{report.env_steps:6} steps, return {mean:.1f}, KL {kl:.4f}")
    exchange.stop("the example is over", final=True)
    print("parameters_sha256", sha256(chief.state.parameters))


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 2)
