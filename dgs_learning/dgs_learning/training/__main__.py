"""`dgs train`, and `python -m dgs_learning.training` (also under torchrun) on a machine without the suite."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path

from dgs_description.errors import DgsError
from dgs_grasp_planner.runtime import prepare_process
from dgs_learning import paths
from dgs_learning.training.settings import TrainingSettings


def _folder(name: str) -> Path:
    if Path(name).is_file():
        raise argparse.ArgumentTypeError(f"{name} is a file")
    return Path(name)


def parser(prog: str = "python -m dgs_learning.training") -> argparse.ArgumentParser:
    """Files and preset, and one option per field of `TrainingSettings`."""
    out = argparse.ArgumentParser(
        prog,
        description="Train DGS-Net; goes on from the checkpoint in the output folder if there is one.",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
        allow_abbrev=False,
    )
    out.add_argument("--dataset", type=Path, default=paths.dataset_file(), help="dataset file (.npz)")
    out.add_argument("--out", type=_folder, help="folder of checkpoint and curves; else data/train_PRESET")
    out.add_argument("--cache", type=_folder, help="folder that keeps rendered views")
    out.add_argument("--init", help="weights to start from: a name in the models directory, or folder/name")
    out.add_argument("--preset", default="fast", help="network configuration: fast, paper, shapes or tiny")
    for field in fields(TrainingSettings):
        names = [f"--{name}" for name in (field.name.replace("_", "-"), field.metadata["also"]) if name]
        of_type = type(field.default)
        kind = {"action": argparse.BooleanOptionalAction} if of_type is bool else {"type": of_type}
        out.add_argument(*names, dest=field.name, default=field.default, help=field.metadata["help"], **kind)  # type: ignore[arg-type]
    return out


def main(arguments: Sequence[str] | None = None, prog: str = "python -m dgs_learning.training") -> int:
    """Train; return the exit code, 2 for bad input."""
    values = vars(parser(prog).parse_args(arguments))
    dataset, out, cache, init, preset = (values.pop(k) for k in ("dataset", "out", "cache", "init", "preset"))
    prepare_process()
    from dgs_learning.training.start import TrainingFiles, start_training  # loads torch

    start = None if not init else Path(init) if "/" in init else paths.weights_dir() / init
    files = TrainingFiles(dataset, out or paths.data_dir() / f"train_{preset}", cache, start)
    try:
        start_training(preset, files, TrainingSettings(**values))
    except DgsError as error:
        print(f"error {error.code.value} {error.code.name}: {error.message}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
