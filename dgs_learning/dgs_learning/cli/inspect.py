"""`dgs inspect`: what a dataset file holds, as tables and pictures."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dgs_learning.cli.options import Json


def inspect(
    file: Annotated[Path | None, typer.Argument(help="Dataset file; else the shipped one.")] = None,
    json_file: Json = None,
    pictures: Annotated[Path | None, typer.Option(help="Draw contact sheets into this folder.")] = None,
    per_class: Annotated[int, typer.Option(min=1, help="Grasps per sheet.")] = 15,
    scenes: Annotated[int, typer.Option(min=0, help="Scenes that are drawn.")] = 4,
    seed: Annotated[int, typer.Option(min=0, help="Which grasps and scenes are drawn.")] = 0,
) -> None:
    """Tables of objects, grasps and scenes beside the paper's Table I, and pictures of them."""
    from dgs_learning.cli.files import existing_dataset, write_json
    from dgs_learning.dataset import load_dataset
    from dgs_learning.inspection.tables import as_text, describe

    source = existing_dataset(file)
    data = load_dataset(source)
    summary = {"dataset": source.name, "megabytes": round(source.stat().st_size / 1e6, 2), **describe(data)}
    typer.echo(as_text(summary))
    write_json(json_file, summary)
    if not pictures:
        return
    import numpy as np

    from dgs_learning.inspection.grasp_sheet import grasp_sheet
    from dgs_learning.inspection.scene_sheet import scene_sheet
    from dgs_sim_bridge.render.object_model import SHAPE_CLASSES

    for shape_class in SHAPE_CLASSES:
        page = pictures / f"grasps_{shape_class}.png"
        if grasp_sheet(page, data, shape_class, per_class, seed):
            typer.echo(str(page))
    if scenes and data.scenes:
        numbers = np.random.default_rng(seed).permutation(len(data.scenes))[:scenes]
        scene_sheet(pictures / "scenes.png", data, sorted(numbers.tolist()), seed)
        typer.echo(str(pictures / "scenes.png"))
