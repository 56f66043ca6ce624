"""Starts or goes on with a training: what `dgs train` and `python -m dgs_learning.training` have in common."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from dgs_description.errors import DgsError, ErrorCode
from dgs_grasp_planner.network import PRESETS
from dgs_grasp_planner.network.weights import file_sha256
from dgs_learning.dataset import load_dataset
from dgs_learning.training.batches import cloud_settings
from dgs_learning.training.processes import joined
from dgs_learning.training.settings import TrainingSettings
from dgs_learning.training.train import Trainer
from dgs_learning.training.views import ViewSource


@dataclass(frozen=True)
class TrainingFiles:
    """Where a training reads and writes.

    Attributes:
        dataset: the compact dataset file.
        out: folder of checkpoint, weights and curves.
        cache: folder that keeps rendered views, or None.
    """

    dataset: Path
    out: Path
    cache: Path | None = None


def start_training(preset: str, files: TrainingFiles, settings: TrainingSettings) -> Trainer:
    """Train to the last step, from the checkpoint in the output folder if there is one.

    Args:
        preset: name of the network's configuration.
        files: where to read and write.
        settings: how long and how.

    Raises:
        DgsError: REQUEST_INVALID (preset, dataset, device).
    """
    if preset not in PRESETS:
        raise DgsError(ErrorCode.REQUEST_INVALID, f"no preset {preset!r}; there are {', '.join(PRESETS)}")
    config = PRESETS[preset]
    try:
        dataset = load_dataset(files.dataset)
    except (OSError, ValueError, KeyError) as error:
        raise DgsError(
            ErrorCode.REQUEST_INVALID, f"the dataset {files.dataset} cannot be read: {error}"
        ) from error
    source = ViewSource(dataset, settings.seed, cloud=cloud_settings(config), cache=files.cache)
    notes = {
        "dataset": {"file": files.dataset.name, "sha256": file_sha256(files.dataset)},
        "views": {"distance": source.settings.distance, "elevation": source.settings.elevation},
    }
    with joined(settings.device) as place:
        trainer = Trainer(config, source, files.out, settings, place=place, notes=notes)
        if trainer.resume() and place.first:
            print(f"resumed at step {trainer.step}", flush=True)
        trainer.run()
    return trainer
