"""A trained policy as a file for other programs: TorchScript or ONNX, with its normaliser inside.

Raw observations [N, O] in, the most likely actions [N, A] out, within the environment's bounds.
Each file is loaded again and compared with the trainer's own policy, in NumPy, on observations of
real episodes, before it gets its name.
"""

import logging
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from dppo.config import Config
from dppo.errors import RunFailedError, UsageError
from dppo.store.checkpoint import Checkpoint
from workers.envs import Adapter, make_env, spaces_of
from workers.evaluate import plans_of
from workers.play import play
from workers.policy import FrozenPolicy

if TYPE_CHECKING:
    pass

Float64 = NDArray[np.float64]
Actor = Callable[[Float64], NDArray[np.float32]]
TOLERANCE = 1e-4
"""Largest difference of an action; float32 in another order of sums stays far below."""
_EPISODES = 2


@dataclass(frozen=True, slots=True)
class Verified:
    """What a file does, compared with the trainer's policy."""

    path: Path
    observations: int
    difference: float
    """Largest, of any action."""


class Exporter:
    """A checkpoint's policy, and observations to verify its files with."""

    def __init__(self, checkpoint: Checkpoint, seed: int = 0) -> None:
        """Plays two episodes.

        Raises:
            UsageError: the policy cannot be put into one module; says why.
        """
        from dppo.torch_policy import PolicyModule

        env = make_env(Config.from_dict(checkpoint.facts["config"]).run)
        policy, box = FrozenPolicy(checkpoint, spaces_of(env)), env.action_space
        self._adapter = Adapter(env.observation_space, box)
        env.close()
        low, high = (box.low, box.high) if isinstance(box, spaces.Box) else (-np.inf, np.inf)
        try:
            self._module: PolicyModule = PolicyModule.load(
                checkpoint, np.ravel(low), np.ravel(high)
            ).eval()
        except ValueError as error:
            raise UsageError(f"cannot export: {error}") from error
        plans = plans_of(seed, _EPISODES, places=0)
        self._obs = np.concatenate([kept.obs for _, kept in play(policy, plans, keep=True)])
        modes = policy.actions(self._obs, np.zeros(len(self._obs), np.int64), None)
        self._expected = self._adapter.to_envs(modes).reshape(len(modes), -1)

    def torchscript(self, path: Path) -> Verified:
        """Write a TorchScript file, for `torch.jit.load`, also from C++."""
        import torch

        def actor(file: Path) -> Actor:
            module: Any = torch.jit.load(str(file))
            return lambda obs: np.asarray(module(torch.from_numpy(obs)).detach().numpy())

        def write(file: Path) -> None:
            torch.jit.script(self._module).save(str(file))

        return self._verified(path, write, actor)

    def onnx(self, path: Path) -> Verified:
        """Write an ONNX file: input `obs` [batch, O] of float64, output `action` [batch, A].

        Raises:
            UsageError: the packages for it are not installed.
        """
        import torch

        try:
            import onnxruntime
            import onnxscript  # noqa: F401  torch needs it, and would say so in many lines
        except ImportError as error:
            raise UsageError(
                f"--onnx needs the package {error.name}, which is not installed; "
                "pip install 'dppo[export]'"
            ) from error

        def actor(file: Path) -> Actor:
            session = onnxruntime.InferenceSession(file.read_bytes())
            return lambda obs: np.asarray(session.run(None, {"obs": obs})[0])

        def write(file: Path) -> None:
            logging.getLogger("torch.onnx").setLevel(logging.ERROR)  # what it does without
            torch.onnx.export(
                self._module,
                (torch.from_numpy(self._obs[:2]),),
                str(file),
                input_names=["obs"],
                output_names=["action"],
                dynamic_shapes={"obs": {0: torch.export.Dim("batch")}},
                external_data=False,
                dynamo=True,
                verbose=False,
            )

        return self._verified(path, write, actor)

    def _verified(
        self, path: Path, write: Callable[[Path], None], actor: Callable[[Path], Actor]
    ) -> Verified:
        """Write beside the file, compare, and only then give it its name.

        Raises:
            RunFailedError: it acts otherwise.
        """
        part = path.with_name(f".{path.name}.part")
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # torch announces its future, users cannot help it
                write(part)
                act = actor(part)
            found = [act(self._obs), *(act(row[None]) for row in self._obs[:3])]
            expected = [self._expected, *(row[None] for row in self._expected[:3])]
            difference = max(
                float(np.abs(a - b).max()) for a, b in zip(found, expected, strict=True)
            )
            if not difference <= TOLERANCE:
                raise RunFailedError(
                    f"{path.name} acts otherwise than the trainer's policy: actions differ by up "
                    f"to {difference:g}, expected at most {TOLERANCE:g}; nothing was written"
                )
            part.replace(path)
        finally:
            part.unlink(missing_ok=True)
        return Verified(path, len(self._obs), difference)
