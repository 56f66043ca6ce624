"""`dgs objects`, `dgs grasps`, `dgs scenes`: from object shapes to the dataset file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from dgs_learning import paths
from dgs_learning.cli.options import Backend, Cluster, Seed, Workers

if TYPE_CHECKING:
    from dgs_sim_bridge.render.object_model import ObjectModel

Known = Annotated[
    Path | None,
    typer.Option(exists=True, dir_okay=False, help="Dataset file whose object-scales, or scenes, are kept."),
]
Others = Annotated[
    str,
    typer.Option(
        help="More objects: everyday, oversize, or folders in the import format (@train takes that part of one), "
        "separated by commas."
    ),
]


def _load(others: str) -> list[ObjectModel]:
    from dgs_learning.objects.catalogue import load_part

    return [model for where in filter(None, others.split(",")) for model in load_part(where)]


def objects(
    name: Annotated[Literal["novel", "household"], typer.Argument(help="Which.")] = "novel",
    seed: Annotated[
        int | None, typer.Option(min=0, help="Of the shapes; default: the catalogue's own.")
    ] = None,
    out: Annotated[Path | None, typer.Option(dir_okay=False, help="Catalogue file to write.")] = None,
) -> None:
    """Write a catalogue of test objects, and count how they lie when each is dropped alone."""
    from dgs_description.paths import models_dir
    from dgs_learning.evaluation.resting import dropped_kinds
    from dgs_learning.objects.catalogue import make_catalogue
    from dgs_sim_bridge.render.object_model import CATALOGUES, save_catalogue

    target = out or models_dir() / CATALOGUES[name]
    models = make_catalogue(name, seed)
    save_catalogue(target, models)
    typer.echo(f"{len(models)} {name} objects -> {target}")
    kinds = dropped_kinds(models)
    shares = ", ".join(f"{kind} {100 * count / kinds.total():.0f} %" for kind, count in kinds.items())
    typer.echo(f"{kinds.total()} drops: {shares}")


def grasps(
    seed: Seed = 0,
    target: Annotated[
        int, typer.Option(min=1, help="Grasps per object and scale after which it is done.")
    ] = 24,
    max_chunks: Annotated[
        int, typer.Option(min=1, help="Chunks of draws after which it is done all the same.")
    ] = 5,
    per_pose: Annotated[int, typer.Option(min=1, help="Grasps per resting pose at least.")] = 4,
    scales: Annotated[int, typer.Option(min=1, max=5, help="Scales per object, taken in turn.")] = 1,
    varied: Annotated[int, typer.Option(min=0, help="Grasps of each after varying those found.")] = 0,
    known: Known = None,
    others: Others = "",
    workers: Workers = 0,
    backend: Backend = "loky",
    cluster: Cluster = "",
) -> None:
    """Stage 1: validated grasps of single objects. Resumable: what is done is skipped, down to the chunk."""
    from dgs_learning.dataset import load_dataset
    from dgs_learning.parallel import Engine
    from dgs_learning.synthesis.generate import generate_grasps, restore, vary_grasps, work_list
    from dgs_learning.synthesis.stage_one import Effort

    engine = Engine(workers, backend, cluster)
    models, folder = work_list(seed, scales, _load(others)), paths.data_dir() / "stage1"
    if known is not None:
        kept = restore(load_dataset(known), [model for model, _ in models], folder)
        typer.echo(f"{kept} object-scales kept from {known}")
    effort = Effort(target, max_chunks, per_pose, varied=varied)
    made = generate_grasps(models, folder, effort, engine)
    more = vary_grasps(models, folder, effort, engine)
    typer.echo(f"{made} grasps made, {more} variations")


def scenes(
    out: Annotated[Path, typer.Option(dir_okay=False, help="Dataset file to write.")],
    seed: Seed = 0,
    count: Annotated[int, typer.Option(min=1, help="Number of scenes, besides those that are kept.")] = 240,
    known: Known = None,
    others: Others = "",
    workers: Workers = 0,
    backend: Backend = "loky",
    cluster: Cluster = "",
) -> None:
    """Stage 2: settled scenes with their feasible grasps, packed with stage 1 into the dataset file. Resumable."""
    from dgs_description.paths import revision
    from dgs_learning.dataset import load_dataset, save_dataset
    from dgs_learning.parallel import Engine
    from dgs_learning.synthesis.generate import collect, generate_scenes, with_scenes_of, work_list

    models = [model for model, _ in work_list(0, 5, _load(others))]
    grasps = collect(models, paths.data_dir() / "stage1")
    if known is not None:
        grasps = with_scenes_of(grasps, load_dataset(known))
    engine = Engine(workers, backend, cluster)
    kept = paths.kept_folder(paths.data_dir() / "stage2", revision())
    dataset = generate_scenes(grasps, count, seed, engine, kept)
    save_dataset(out, dataset)
    total = sum(len(scene.instance) for scene in dataset.scenes)
    typer.echo(
        f"{len(dataset.objects)} objects, {len(dataset.grasps)} grasps, {len(dataset.scenes)} scenes, "
        f"{total} scene grasps -> {out} ({out.stat().st_size / 1e6:.1f} MB)"
    )
