"""`dgs export`: whole scenes to disk, in the layout of the authors' release."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dgs_learning.cli.options import Backend, Cluster, Dataset, Workers, number_range


def _numbers(text: str, count: int) -> list[int]:
    """Scene numbers of "3", "0-9" or "" (all)."""
    if not text:
        return list(range(count))
    first, last = number_range(text)
    if not 0 <= first <= last < count:
        raise typer.BadParameter(f"{text} is not within the dataset's scenes 0-{count - 1}")
    return list(range(first, last + 1))


def export(
    out: Annotated[
        Path,
        typer.Option(file_okay=False, help="Folder that gets scene_0000 and so on; finished scenes stay."),
    ],
    scenes: Annotated[str, typer.Option(help="A number or a range such as 0-9; all if not given.")] = "",
    views: Annotated[int, typer.Option(min=1, help="Viewpoints per scene.")] = 256,
    seed: Annotated[int, typer.Option(min=0, help="Of the depth noise and the drawn points.")] = 0,
    points: Annotated[int, typer.Option(min=100, help="Points of a cloud, at most.")] = 20_000,
    stage_one: Annotated[
        Path | None, typer.Option(file_okay=False, help="Write the stage-1 grasps here as well.")
    ] = None,
    dataset: Dataset = None,
    workers: Workers = 0,
    backend: Backend = "loky",
    cluster: Cluster = "",
) -> None:
    """Write images, clouds, masks, poses and labels of whole scenes (docs/dataset.md says what each file holds)."""
    from tqdm import tqdm

    from dgs_learning.cli.files import existing_dataset
    from dgs_learning.dataset import load_dataset
    from dgs_learning.export.write import ExportSettings, export_scenes, export_stage_one
    from dgs_learning.parallel import Engine

    data = load_dataset(existing_dataset(dataset))
    numbers = _numbers(scenes, len(data.scenes))
    engine = Engine(workers, backend, cluster)
    settings = ExportSettings(views=views, seed=seed, points=points)
    done = 0
    for _ in tqdm(export_scenes(data, numbers, out, settings, engine), unit="scene", desc="export"):
        done += 1
    typer.echo(f"{done} scenes written, {len(numbers) - done} were there -> {out}")
    if stage_one:
        typer.echo(f"{export_stage_one(data, stage_one)} stage-1 files -> {stage_one}")
