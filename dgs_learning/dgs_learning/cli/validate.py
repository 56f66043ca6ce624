"""`dgs validate`: simulates stored grasps again, from the numbers in the dataset file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from dgs_learning import paths
from dgs_learning.cli.options import Backend, Cluster, Dataset, Friction, Json, Physics, Workers


def validate(
    stage: Annotated[
        int, typer.Option(min=1, max=2, help="1: six-axis test of single grasps; 2: executed in their scene.")
    ] = 1,
    count: Annotated[int, typer.Option(min=1, help="Grasps drawn at random from the file.")] = 500,
    seed: Annotated[int, typer.Option(min=0, help="Which grasps, and the poses they are tried in.")] = 0,
    dataset: Dataset = None,
    json_file: Json = None,
    shape_class: Annotated[
        list[str] | None,
        typer.Option(help="Draw among grasps on this class only (or with --fingers); repeatable."),
    ] = None,
    fingers: Annotated[
        list[int] | None,
        typer.Option(help="Draw among grasps with so many fingers only (or --shape-class); repeatable."),
    ] = None,
    physics: Physics = "pybullet",
    friction: Friction = None,
    rules: Annotated[
        Literal["paper", "dexgraspbench"],
        typer.Option(help="Stage 1: what a grasp has to stand; dexgraspbench wants --engine mujoco."),
    ] = "paper",
    drop: Annotated[
        Path | None,
        typer.Option(dir_okay=False, help="Stage 1: write here the dataset without the grasps that failed."),
    ] = None,
    folder: Annotated[Path | None, typer.Option(help="Finished checks are kept here.")] = None,
    workers: Workers = 0,
    backend: Backend = "loky",
    cluster: Cluster = "",
) -> None:
    """Simulate stored grasps again with other seeds. An interrupted run goes on where it was."""
    from dgs_learning import validation
    from dgs_learning.cli.files import existing_dataset, put_out
    from dgs_learning.cli.refusal import refuse
    from dgs_learning.dataset import load_dataset, save_dataset
    from dgs_learning.objects.catalogue import TRAIN_COUNTS
    from dgs_learning.parallel import Engine

    file = existing_dataset(dataset)
    if drop and stage != 1:
        refuse("--drop takes grasps of single objects off the file: use it with --stage 1")
    unknown = sorted(set(shape_class or ()) - set(TRAIN_COUNTS))
    if unknown:
        refuse(f"there is no shape class {unknown[0]}, only {', '.join(TRAIN_COUNTS)}")
    if rules == "dexgraspbench" and physics != "mujoco":
        refuse("the rules dexgraspbench are of MuJoCo: use --engine mujoco")
    if stage == 2 and rules != "paper":
        refuse(f"there are no rules {rules} for stage 2, only for stage 1")
    processes, kept = Engine(workers, backend, cluster), folder or paths.data_dir() / "validate"
    among = shape_class or (), fingers or ()
    summary = validation.validate(file, stage, count, seed, processes, kept, *among, physics, friction, rules)
    put_out("validation.txt", summary, json_file)
    if drop:
        save_dataset(drop, load_dataset(file).without(summary["failed"]))
        typer.echo(f"{len(summary['failed'])} grasps dropped, the rest is in {drop}")
