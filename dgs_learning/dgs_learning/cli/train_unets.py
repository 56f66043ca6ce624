"""`dgs train-completion` and `dgs train-shape-completion`: the small networks that fill in what a camera misses."""

from __future__ import annotations

from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Annotated

import typer

from dgs_description.paths import models_dir
from dgs_learning import paths
from dgs_learning.cli.files import existing_dataset
from dgs_learning.cli.options import Dataset, Seed

Out = Annotated[Path | None, typer.Option(file_okay=False, help="Folder of views and checkpoint.")]
Views = Annotated[int, typer.Option(min=100, help="Rendered views.")]
Steps = Annotated[int, typer.Option(min=1, help="Updates.")]
Ship = Annotated[bool, typer.Option(help="Put the weights and their card into the models folder.")]


def train_completion(
    out: Out = None,
    dataset: Dataset = None,
    views: Views = 1200,
    steps: Steps = 3000,
    seed: Seed = 0,
    ship: Ship = True,
) -> None:
    """Train the depth completion on one core; goes on from the checkpoint in the output folder if there is one."""
    _train("completion", out, dataset, ship, views=views, steps=steps, seed=seed)


def train_shape_completion(
    out: Out = None,
    dataset: Dataset = None,
    views: Views = 12000,
    steps: Steps = 24000,
    batch: Annotated[int, typer.Option(min=8, help="Squares per update.")] = 16,
    device: Annotated[str, typer.Option(help="cpu or cuda.")] = "cpu",
    rate: Annotated[float, typer.Option(min=0.0, help="Peak of the learning rate.")] = 2e-3,
    workers: Annotated[int, typer.Option(min=0, help="Processes that render.")] = 1,
    start: Annotated[str, typer.Option(help="File of weights to begin with.")] = "",
    seed: Seed = 0,
    ship: Ship = True,
) -> None:
    """Train the shape completion; goes on from the checkpoint in the output folder if there is one."""
    changes: dict[str, float | str] = {"views": views, "steps": steps, "batch": batch, "learning_rate": rate}
    changes |= {"device": device, "workers": workers, "start": start, "seed": seed}
    _train("shape_completion", out, dataset, ship, **changes)


def _train(module: str, out: Path | None, dataset: Path | None, ship: bool, **changes: float | str) -> None:
    """Train the network of a module of `dgs_learning.training`, by its settings with some changes.

    Args:
        out: folder of views and checkpoint; None = the one of the module's name in the data folder.
    """
    import torch

    from dgs_learning.dataset import load_dataset
    from dgs_learning.training.train import find_device

    torch.set_num_threads(1)
    network = import_module(f"dgs_learning.training.{module}")
    settings = replace(network.SETTINGS, **changes)
    find_device(settings.device)
    data = load_dataset(existing_dataset(dataset))
    net, measured = network.train(data, out or paths.data_dir() / module, settings)
    if ship:
        typer.echo(f"-> {network.ship_network(net, measured, settings, models_dir())}")
