"""`python -m dgs_learning.training`, also under torchrun: training on a machine with torch, numpy and scipy only."""

from __future__ import annotations

import argparse
import sys
from dataclasses import fields
from pathlib import Path

from dgs_description.errors import DgsError
from dgs_grasp_planner.runtime import prepare_process
from dgs_learning.training.settings import TrainingSettings


def parser() -> argparse.ArgumentParser:
    """Files and preset, and one option per field of `TrainingSettings`."""
    out = argparse.ArgumentParser(
        prog="python -m dgs_learning.training",
        description=__doc__,
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    out.add_argument("--dataset", type=Path, required=True, help="dataset file (.npz)")
    out.add_argument("--out", type=Path, required=True, help="folder of checkpoint, weights and curves")
    out.add_argument("--cache", type=Path, help="folder that keeps rendered views")
    out.add_argument("--init", type=Path, help="weights to start from, folder/name")
    out.add_argument("--preset", default="fast", help="network configuration: fast, paper or tiny")
    for field in fields(TrainingSettings):
        option = f"--{field.name.replace('_', '-')}"
        if isinstance(field.default, bool):
            out.add_argument(option, action=argparse.BooleanOptionalAction, default=field.default, help=" ")
        else:
            out.add_argument(option, type=type(field.default), default=field.default, help=" ")
    return out


def main(arguments: list[str] | None = None) -> int:
    """Train; return the exit code, 2 for bad input."""
    values = vars(parser().parse_args(arguments))
    prepare_process()
    from dgs_learning.training.start import TrainingFiles, start_training  # loads torch

    try:
        settings = TrainingSettings(**{f.name: values[f.name] for f in fields(TrainingSettings)})
        files = TrainingFiles(values["dataset"], values["out"], values["cache"], values["init"])
        start_training(values["preset"], files, settings)
    except DgsError as error:
        print(f"error {error.code.value} {error.code.name}: {error.message}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
