"""`dgs evaluate`: the paper's clearing protocol with a free hand in simulation."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dgs_learning import paths
from dgs_learning.commands.refusal import refusals

if TYPE_CHECKING:
    from dgs_sim_bridge.object_model import ObjectModel


def _one_thread_each() -> None:
    """Sums of several threads depend on their number, and the scenes already run in parallel."""
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")  # read when numpy and torch are imported, here and in the workers


def _catalogue(objects: str, dataset: Path | None) -> tuple[str, list[ObjectModel]]:
    """Name and objects of what `--objects` says."""
    from dgs_learning.dataset import load_dataset
    from dgs_learning.objects.catalogue import train_catalogue
    from dgs_sim_bridge.object_model import load_catalogue

    if objects == "train":
        return objects, train_catalogue()
    if objects == "dataset":
        return objects, load_dataset(dataset or paths.dataset_file()).objects
    where = paths.novel_file() if objects == "novel" else Path(objects)
    return ("novel" if objects == "novel" else where.name), load_catalogue(where)


def _range(words: str) -> tuple[int, int]:
    low, _, high = words.partition("-")
    try:
        return int(low), int(high or low)
    except ValueError:
        raise typer.BadParameter(f"{words!r} is neither a number nor a range such as 4-6") from None


def evaluate(
    out: Annotated[Path, typer.Option(help="Folder of the results; an unfinished run in it goes on.")],
    objects: Annotated[
        str,
        typer.Option(
            help="novel, train, dataset (those with stored grasps), a folder in the import format, or a catalogue file."
        ),
    ] = "novel",
    scenes: Annotated[int, typer.Option(help="Number of scenes.")] = 10,
    objects_per_scene: Annotated[str, typer.Option(help="A number or a range such as 4-6.")] = "10",
    workspace: Annotated[tuple[float, float], typer.Option(help="Extent in x and y [m].")] = (0.6, 0.6),
    seed: Annotated[
        int, typer.Option(help="The same seed gives the same table on any number of workers.")
    ] = 0,
    planner: Annotated[str, typer.Option(help="dgs_net, top_down, random_prior or replay.")] = "dgs_net",
    ablate: Annotated[str, typer.Option(help="none, pre_grasp or offset (Table II).")] = "none",
    model: Annotated[str, typer.Option(help="Name of the weights.")] = "dgs_net",
    models_dir: Annotated[Path | None, typer.Option(help="Where the weights lie.")] = None,
    dataset: Annotated[Path | None, typer.Option(help="Dataset file of random_prior and replay.")] = None,
    workers: Annotated[int, typer.Option(help="Processes; 0 = one per core.")] = 0,
) -> None:
    """The paper's clearing protocol with a free hand in simulation; writes summary, table and report."""
    _one_thread_each()
    from dgs_learning.evaluation.baselines import PlannerChoice
    from dgs_learning.evaluation.protocol import Setting
    from dgs_learning.evaluation.report import write_report
    from dgs_learning.evaluation.run import run_experiment, table

    try:
        setting = Setting(scenes, _range(objects_per_scene), workspace, seed, ablate)
        choice = PlannerChoice(planner, model, models_dir, dataset)
        with refusals():
            name, catalogue = _catalogue(objects, dataset)
            cores = workers or len(os.sched_getaffinity(0))
            typer.echo(table(run_experiment(catalogue, name, choice, setting, out, cores)))
    except (ValueError, FileNotFoundError) as error:
        raise typer.BadParameter(str(error)) from None
    typer.echo(f"report: {write_report([out], out / 'report.html')}")
