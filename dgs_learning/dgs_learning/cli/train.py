"""`dgs train`: from the dataset file to weights."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dgs_learning import paths
from dgs_learning.cli.options import Seed
from dgs_learning.cli.refusal import refusals


def train(
    preset: Annotated[str, typer.Option(help="Network configuration: fast or paper.")] = "fast",
    epochs: Annotated[float, typer.Option(help="Passes over all scenes and viewpoints.")] = 40.0,
    steps: Annotated[int, typer.Option(help="Updates in all; 0 = as the epochs say.")] = 0,
    batch: int = 10,
    learning_rate: float = 1e-3,
    views: Annotated[int, typer.Option(help="Viewpoints per scene.")] = 256,
    seed: Seed = 0,
    workers: Annotated[int, typer.Option(help="Processes that prepare views.")] = 1,
    threads: Annotated[int, typer.Option(help="Torch threads; 0 = torch's default.")] = 0,
    device: Annotated[str, typer.Option(help="cpu or cuda.")] = "cpu",
    precision: Annotated[str, typer.Option(help="fp32, bf16, or auto = bf16 on a GPU.")] = "auto",
    held_out: Annotated[int, typer.Option(help="Scenes that are only measured on.")] = 4,
    scenes: Annotated[int, typer.Option(help="Scenes that are trained on; 0 = all others.")] = 0,
    validate_every: Annotated[
        int, typer.Option(help="Steps between two such measurements; 0 = never.")
    ] = 200,
    dataset: Annotated[Path | None, typer.Option(help="Dataset file.")] = None,
    out: Annotated[Path | None, typer.Option(help="Folder of checkpoints and curves.")] = None,
    cache: Annotated[Path | None, typer.Option(help="Keep rendered views here.")] = None,
    init: Annotated[
        str, typer.Option(help="Weights to start from: a name in the models directory, or folder/name.")
    ] = "",
) -> None:
    """Train DGS-Net; goes on from the checkpoint in the output folder if there is one."""
    from dgs_grasp_planner.runtime import prepare_process

    prepare_process()
    from dgs_learning.training.settings import TrainingSettings
    from dgs_learning.training.start import TrainingFiles, start_training

    start = None if not init else Path(init) if "/" in init else paths.models_dir() / init
    target = out or paths.data_dir() / f"train_{preset}"
    files = TrainingFiles(dataset or paths.dataset_file(), target, cache, start)
    with refusals():
        settings = TrainingSettings(
            epochs=epochs, steps=steps, batch=batch, learning_rate=learning_rate, views_per_scene=views, seed=seed,
            workers=workers, threads=threads, device=device, precision=precision, held_out_scenes=held_out,
            training_scenes=scenes, validate_every=validate_every,
        )  # fmt: skip
        start_training(preset, files, settings)
