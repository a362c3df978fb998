"""Makes `trained_policies.safetensors`: a small trained policy for each batched environment.

    python tests/data/make_trained_policies.py        about ten minutes on two cores

Each is trained with the default recipe, two hidden layers of 16 units and seed 1 for 120,000
steps. Under `<id>/0` to `<id>/8` lie mean and scale of the observations, W and b of the three
layers, and log std. What matters to the tests is that the robots move as trained ones do.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from safetensors.numpy import save_file

from dppo.config import Config
from dppo.networks import Networks
from dppo.store.checkpoint import newest_checkpoint
from dppo.store.contents import spaces_in, statistics_in

NAMES = (
    "Ant", "HalfCheetah", "Hopper", "Walker2d", "Humanoid", "HumanoidStandup", "Swimmer",
    "InvertedPendulum", "InvertedDoublePendulum", "Reacher", "Pusher",
)  # fmt: skip


def trained(env_id: str, folder: Path) -> list[np.ndarray]:
    """Mean, scale, layers and log std of a policy trained for this environment."""
    command = [
        sys.executable, "-m", "learner", "--env", env_id, "--seed", "1", "--hidden-sizes", "16",
        "16", "--total-timesteps", "120000", "--run-dir", str(folder / env_id),
    ]  # fmt: skip
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    checkpoint = newest_checkpoint(folder / env_id / "checkpoints")
    assert checkpoint is not None
    config = Config.from_dict(checkpoint.facts["config"])
    networks = Networks.build(spaces_in(checkpoint), config)
    normalizer = statistics_in(checkpoint).obs_normalizer(config.rollout)
    policy, log_std = networks.split_policy(checkpoint.arrays["parameters"])
    layers = [array for layer in networks.policy.layers(policy) for array in layer]
    return [normalizer.mean, normalizer.scale, *layers, log_std]


def main() -> None:
    """Train all of them, one after the other."""
    arrays = {}
    with tempfile.TemporaryDirectory() as folder:
        for name in NAMES:
            for version in ("v4", "v5"):
                env_id = f"{name}-{version}"
                if env_id == "Pusher-v4":  # not for MuJoCo 3 and later
                    continue
                for number, array in enumerate(trained(env_id, Path(folder))):
                    arrays[f"{env_id}/{number}"] = np.ascontiguousarray(array, np.float32)
                print(env_id, flush=True)
    save_file(arrays, Path(__file__).with_name("trained_policies.safetensors"))


if __name__ == "__main__":
    main()
