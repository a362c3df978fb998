"""The trainers that dppo is measured against; started by `end_to_end.py`.

    PEERS/bin/python -m benchmarks.peers TRAINER ENV FILE

Each trains until it is ended, and appends to FILE when which step was reached, in the form of
dppo's metrics.jsonl. Imports nothing of dppo, so an environment with the peers alone is enough.
"""

import json
import re
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

Note = Callable[[int], None]


def _stable_baselines(subprocesses: bool, **settings: int) -> Callable[[str, Note], None]:
    """SB3's PPO with 8 environments; settings not given are its defaults."""

    def train(env_id: str, note: Note) -> None:
        from stable_baselines3 import PPO
        from stable_baselines3.common.callbacks import BaseCallback
        from stable_baselines3.common.env_util import make_vec_env
        from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv

        class Marks(BaseCallback):  # type: ignore[misc]
            """A line whenever a rollout begins: the iteration before is over, learning too."""

            def _on_step(self) -> bool:
                return True

            def _on_rollout_start(self) -> None:
                note(self.num_timesteps)

        kind = SubprocVecEnv if subprocesses else DummyVecEnv
        envs = make_vec_env(env_id, n_envs=8, seed=1, vec_env_cls=kind)
        PPO("MlpPolicy", envs, device="cpu", seed=1, **settings).learn(10_000_000, Marks())

    return train


def _cleanrl(**settings: Any) -> Callable[[str, Note], None]:  # noqa: ANN401  see Settings
    """CleanRL's settings in our loop."""

    def train(env_id: str, note: Note) -> None:
        from benchmarks.cleanrl_like import Settings
        from benchmarks.cleanrl_like import train as run

        run(env_id, Settings(**settings), note)

    return train


def _sample_factory(env_id: str, note: Note) -> None:
    """Sample Factory, asynchronous, its defaults; counted every 5 s, when it logs its frames."""
    import logging

    from sample_factory.utils.utils import log
    from sf_examples.mujoco import train_mujoco

    class Marks(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            found = re.search(r"Total num frames: (\d+)", record.getMessage())
            if found and int(found[1]) > Marks.last:
                Marks.last = int(found[1])
                note(Marks.last)

        last = -1

    log.addHandler(Marks())
    name = {"Ant-v4": "ant", "HalfCheetah-v4": "halfcheetah", "Hopper-v4": "hopper"}
    sys.argv[1:] = [
        f"--env=mujoco_{name.get(env_id, 'walker')}", "--algo=APPO", "--device=cpu",
        "--num_workers=2", "--experiment=peer", f"--train_dir={tempfile.mkdtemp()}",
    ]  # fmt: skip
    train_mujoco.main()


TRAINERS: dict[str, Callable[[str, Note], None]] = {
    "sb3": _stable_baselines(True),
    "sb3-dummy": _stable_baselines(False),
    "sb3-batch": _stable_baselines(True, n_steps=256, n_epochs=5),
    "sb3-equal": _stable_baselines(True, n_steps=256, batch_size=1024, n_epochs=5),
    "sb3-full": _stable_baselines(True, n_steps=256, batch_size=2048, n_epochs=10),
    "cleanrl": _cleanrl(num_envs=1, num_steps=2048, minibatches=32),
    "cleanrl-8": _cleanrl(num_envs=8, num_steps=256, minibatches=32),
    "cleanrl-batch": _cleanrl(num_envs=8, num_steps=256, minibatches=32, epochs=5),
    "cleanrl-equal": _cleanrl(num_envs=8, num_steps=256, minibatches=2, epochs=5),
    "cleanrl-envpool": _cleanrl(num_envs=32, num_steps=128, minibatches=1, backend="envpool"),
    "sample-factory": _sample_factory,
}
"""batch: dppo's batch of 2048 and its 5 epochs, minibatches of 64, the peers' own size; equal:
dppo's 2 minibatches, too; full: one minibatch per epoch."""


def main(trainer: str, env_id: str, file: str) -> None:
    """Train; end with a sentence if the trainer is not installed."""
    import gymnasium
    import mujoco
    import torch

    gymnasium.logger.min_level = gymnasium.logger.ERROR
    mujoco.set_mju_user_warning(lambda _: None)
    torch.set_num_threads(
        1
    )  # never slower here than its default, and twice as fast beside EnvPool
    with Path(file).open("a") as marks:

        def note(steps: int) -> None:
            row = {"time/total_timesteps": steps, "time": time.time()}
            marks.write(json.dumps(row) + "\n")
            marks.flush()

        TRAINERS[trainer](env_id, note)


if __name__ == "__main__":
    main(*sys.argv[1:])
