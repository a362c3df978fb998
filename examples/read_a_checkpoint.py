"""A checkpoint without this package: JSON, safetensors and NumPy are enough.

    python examples/read_a_checkpoint.py runs/pendulum/checkpoints/iteration-00000074

What lies where is described in docs/embedding.md. This reads runs of the default preset on
environments with continuous actions; others differ as said there.
"""

import json
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from safetensors.numpy import load_file


class Policy:
    """The most likely action of a raw observation, before the environment's bounds clip it."""

    def __init__(self, folder: Path) -> None:
        facts = json.loads((folder / "manifest.json").read_text())["facts"]
        arrays = load_file(folder / "arrays.safetensors")
        config, spaces = facts["config"], facts["spaces"]

        inputs, (outputs,) = spaces["obs_size"], spaces["action_sizes"]
        hidden = config["network"]["hidden_sizes"]
        sizes = [inputs, *hidden, outputs]
        start, self.layers = 0, []
        for before, after in pairwise(sizes):
            weights = arrays["parameters"][start : start + before * after]
            start += before * after
            biases = arrays["parameters"][start : start + after]
            start += after
            self.layers.append((weights.reshape(before, after), biases))

        count, *moments = arrays["statistics/obs"]
        self.mean, deviations = np.split(np.array(moments), 2)
        self.scale = np.sqrt(deviations / count + 1e-8)
        self.clip = float(config["rollout"]["clip_obs"])

    def act(self, obs: NDArray[np.float64]) -> NDArray[np.float32]:
        """[A] for a flattened observation [O]."""
        x = np.clip((obs - self.mean) / self.scale, -self.clip, self.clip).astype(np.float32)
        for weights, biases in self.layers[:-1]:
            x = np.tanh(x @ weights + biases)
        weights, biases = self.layers[-1]
        return np.asarray(x @ weights + biases)


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python examples/read_a_checkpoint.py CHECKPOINT_FOLDER")
    policy = Policy(Path(sys.argv[1]))
    print(f"at the mean observation: {policy.act(policy.mean)}")
