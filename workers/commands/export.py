"""`dppo export`: a trained policy as a file for other programs."""

from dataclasses import dataclass
from pathlib import Path

from dppo.arguments import RunFolder
from dppo.config import require_seed
from dppo.settings import require
from workers.commands.targets import check_targets


@dataclass(frozen=True, kw_only=True)
class ExportArgs:
    """Write a run's policy as ONNX or TorchScript: raw observations in, actions out; verified."""

    run: RunFolder
    """Run directory, or one checkpoint folder in it."""
    onnx: str = ""
    """File to write, e.g. policy.onnx; needs the extra `export`."""
    torchscript: str = ""
    """File to write, e.g. policy.pt."""
    which: str = "best"
    """best, newest, or a checkpoint's name such as iteration-00000040."""
    seed: int = 0
    """Of the episodes whose observations the files are verified with."""

    def __post_init__(self) -> None:
        """Refuse what cannot be run."""
        require(
            bool(self.onnx or self.torchscript),
            "onnx",
            "empty and --torchscript, too",
            "a file for one of them",
        )
        require_seed(self.seed)


def run(args: ExportArgs) -> int:
    """Write and verify."""
    check_targets(*filter(None, (args.onnx, args.torchscript)))
    from dppo.store.contents import chosen
    from workers.envs import quiet
    from workers.export import Exporter

    quiet()
    path, checkpoint = chosen(args.run, args.which)
    exporter = Exporter(checkpoint, args.seed)
    verified = [exporter.torchscript(Path(args.torchscript))] if args.torchscript else []
    if args.onnx:
        verified.append(exporter.onnx(Path(args.onnx)))
    for one in verified:
        print(
            f"{one.path}: {path.name}, largest difference from the trainer's own actions on "
            f"{one.observations} observations {one.difference:.3g}"
        )
    return 0
