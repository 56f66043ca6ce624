"""Starts or goes on with a training, alone or as one of the processes that torchrun started."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path

import torch.distributed as dist

from dgs_description.errors import DgsError, ErrorCode
from dgs_grasp_planner.network import PRESETS, NetworkConfig
from dgs_grasp_planner.network.weights import SUFFIX, file_sha256, read_info
from dgs_learning.dataset import load_dataset
from dgs_learning.made_from import check_same
from dgs_learning.training.settings import TrainingSettings
from dgs_learning.training.train import Trainer, find_device
from dgs_learning.training.views import ViewSource


@dataclass(frozen=True)
class TrainingFiles:
    """Where a training reads and writes.

    Attributes:
        out: folder of checkpoint, weights and curves.
        cache: folder that keeps rendered views, or None.
        init: weights to start from, `folder/name` with or without `.pt`, or None = from scratch.
    """

    dataset: Path
    out: Path
    cache: Path | None = None
    init: Path | None = None


def start_training(preset: str, files: TrainingFiles, settings: TrainingSettings) -> None:
    """Train to the last step.

    From the checkpoint in the output folder if there is one, else from the weights that the files name, else from
    scratch.

    Raises:
        DgsError: REQUEST_INVALID (preset, dataset, folders, device, weights of another configuration, checkpoint or
            views of another training), WEIGHTS_MISSING, WEIGHTS_ALTERED.
    """
    several = int(os.environ.get("WORLD_SIZE", "1")) > 1
    if several:
        dist.init_process_group("nccl" if find_device(settings.device).type == "cuda" else "gloo")
    try:
        trainer = prepare_training(preset, files, settings)
        begun = "from scratch"
        if trainer.resume():
            begun = f"resumed at step {trainer.step}"
        elif files.init is not None:
            trainer.start_from(files.init.parent, _stem(files.init))
            begun = f"from the weights {files.init}"
        if trainer.rank == 0:
            made = trainer.settings
            print(f"{begun}; {made.steps} steps are {made.epochs:.3g} epochs", flush=True)
        trainer.run()
    finally:
        if several:
            dist.destroy_process_group()


def prepare_training(preset: str, files: TrainingFiles, settings: TrainingSettings) -> Trainer:
    """The trainer of an untrained network; arguments and errors as those of `start_training`."""
    if preset not in PRESETS:
        raise DgsError(ErrorCode.REQUEST_INVALID, f"no preset {preset!r}; there are {', '.join(PRESETS)}")
    config = PRESETS[preset]
    if files.init is not None:
        _check_start(files.init, config)
    dataset = load_dataset(files.dataset)
    if settings.grasps_per_object:
        dataset = dataset.thinned(settings.grasps_per_object, settings.seed)
    try:
        # The paper's network sees the whole table.
        source = ViewSource(dataset, settings.seed, config.keep_table, files.cache)
        notes = {
            "dataset": {"file": files.dataset.name, "sha256": file_sha256(files.dataset)},
            "views": {"distance": source.settings.distance, "elevation": source.settings.elevation},
        }
        return Trainer(config, source, files.out, settings, notes)
    except OSError as error:
        raise DgsError(ErrorCode.REQUEST_INVALID, f"the training's folder cannot be made: {error}") from error


def _stem(weights: Path) -> str:
    return weights.name.removesuffix(SUFFIX)


def _check_start(weights: Path, config: NetworkConfig) -> None:
    """Refuse weights of a network that is built otherwise or fed otherwise than `config` says."""
    other = read_info(weights.parent, _stem(weights)).config
    said = f"the weights {weights} do not fit the preset {config.name!r}"
    check_same(said, replace(other, name=config.name).to_dict(), config.to_dict())
