"""A trained policy as a file for other programs: TorchScript or ONNX, with its normaliser inside.

Raw observations [N, O] in, the most likely actions [N, A] out, as the environment takes them (of
a Discrete space [N, 1]). A policy with a time feature also takes the steps since the reset, [N].
Each file is loaded again and compared with the trainer's own policy, in NumPy, on observations of
real episodes, before it gets its name. An ONNX file also says whose policy it is.
"""

import logging
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dppo.errors import RunFailedError, UsageError
from dppo.store.checkpoint import Checkpoint, sha256
from dppo.store.contents import config_in
from workers.envs import Adapter, make_env, spaces_of
from workers.evaluate import plans_of
from workers.play import play
from workers.policy import FrozenPolicy

Float64 = NDArray[np.float64]
Inputs = dict[str, NDArray[Any]]
"""By name: `obs` [N, O] of float64, and `steps` [N] of int64 with a time feature."""
Actor = Callable[[Inputs], NDArray[Any]]
TOLERANCE = 1e-4
"""Largest difference of an action; float32 in another order of sums stays far below."""
_EPISODES, _STEPS = 2, 2000
"""Played for observations to verify with, and the most steps of each: some need not end."""


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
        """Plays two episodes, of 2,000 steps at most."""
        from dppo.torch_policy import PolicyModule

        env = make_env(config_in(checkpoint).run)
        policy, space = FrozenPolicy(checkpoint, spaces_of(env)), env.action_space
        adapter = Adapter(env.observation_space, space)
        env.close()
        self._module = PolicyModule.load(checkpoint, space)
        plans = plans_of(seed, _EPISODES, places=0)
        played = [kept.obs for _, kept in play(policy, plans, keep=True, max_steps=_STEPS)]
        obs = np.concatenate(played)
        steps = np.concatenate([np.arange(len(one)) for one in played])
        self._inputs: Inputs = {"obs": obs} | ({"steps": steps} if self._module.has_clock else {})
        self._facts = {
            "env": policy.config.run.env,
            "dppo_version": version("dppo"),
            "parameters_sha256": sha256(policy.parameters),
        }
        modes = policy.actions(obs, steps, None)
        self._expected = adapter.to_envs(modes).reshape(len(modes), -1)

    def torchscript(self, path: Path) -> Verified:
        """Write a TorchScript file, for `torch.jit.load`, also from C++."""
        import torch

        def actor(file: Path) -> Actor:
            module: Any = torch.jit.load(str(file))
            return lambda inputs: np.asarray(
                module(*map(torch.from_numpy, inputs.values())).numpy()
            )

        def write(file: Path) -> None:
            torch.jit.script(self._module).save(str(file))

        return self._verified(path, write, actor)

    def onnx(self, path: Path) -> Verified:
        """Write an ONNX file: inputs as `Inputs`, output `action` [batch, A].

        Its metadata say whose policy it is: `env`, `dppo_version`, `parameters_sha256`.

        Raises:
            UsageError: the packages for it are not installed, or of versions that do not fit.
        """
        import torch

        try:
            import onnxruntime
            import onnxscript  # torch needs it, and would say so in many lines
        except ImportError as error:
            raise UsageError(
                f"--onnx needs the package {error.name}, which is not installed; "
                "pip install 'dppo[export]'"
            ) from error

        def actor(file: Path) -> Actor:
            session = onnxruntime.InferenceSession(file.read_bytes())
            return lambda inputs: np.asarray(session.run(None, inputs)[0])

        def write(file: Path) -> None:
            logging.getLogger("torch.onnx").setLevel(logging.ERROR)  # what it does without
            batch = torch.export.Dim("batch")
            try:
                program: Any = torch.onnx.export(
                    self._module,
                    tuple(torch.from_numpy(values[:2]) for values in self._inputs.values()),
                    input_names=list(self._inputs),
                    output_names=["action"],
                    dynamic_shapes={name: {0: batch} for name in self._inputs},
                    dynamo=True,
                    verbose=False,
                )
            except Exception as error:  # of two packages that each change what the other uses
                reason = str(error).partition("\n")[0]
                raise UsageError(
                    f"torch {torch.__version__} and onnxscript {onnxscript.__version__} make no "
                    f"ONNX file together ({type(error).__name__}: {reason}); pip install "
                    "--upgrade onnxscript, or export with --torchscript"
                ) from error
            program.model.metadata_props.update(self._facts)
            program.save(str(file), external_data=False)

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
            cuts = [slice(None), *(slice(row, row + 1) for row in range(3))]
            found = [act({name: all[cut] for name, all in self._inputs.items()}) for cut in cuts]
            difference = max(
                float(np.abs(actions - self._expected[cut]).max())
                for actions, cut in zip(found, cuts, strict=True)
            )
            if not difference <= TOLERANCE:
                raise RunFailedError(
                    f"{path.name} acts otherwise than the trainer's policy: actions differ by up "
                    f"to {difference:g}, expected at most {TOLERANCE:g}; nothing was written"
                )
            part.replace(path)
        finally:
            part.unlink(missing_ok=True)
        return Verified(path, len(self._expected), difference)
