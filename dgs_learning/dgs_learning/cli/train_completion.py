"""`dgs train-completion`: the network that fills in the depth of glass and mirrors."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dgs_description.paths import models_dir
from dgs_learning import paths
from dgs_learning.cli.files import existing_dataset
from dgs_learning.cli.options import Dataset, Seed


def train_completion(
    out: Annotated[Path | None, typer.Option(help="Folder of views and checkpoint.")] = None,
    dataset: Dataset = None,
    views: Annotated[int, typer.Option(min=100, help="Rendered views.")] = 1200,
    steps: Annotated[int, typer.Option(min=1, help="Updates.")] = 3000,
    seed: Seed = 0,
    ship: Annotated[bool, typer.Option(help="Put the weights and their card into the models folder.")] = True,
) -> None:
    """Train the depth completion on one core; goes on from the checkpoint in the output folder if there is one."""
    import torch

    from dgs_learning.dataset import load_dataset
    from dgs_learning.training.completion import CompletionSettings, ship_network, train

    torch.set_num_threads(1)
    file, folder = existing_dataset(dataset), out or paths.data_dir() / "completion"
    settings = CompletionSettings(views=views, steps=steps, seed=seed)
    net, measured = train(load_dataset(file), folder, settings)
    if ship:
        typer.echo(f"-> {ship_network(net, measured, settings, models_dir())}")
