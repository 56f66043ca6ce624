"""`dgs evaluate`: the paper's clearing protocol with a free hand in simulation."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dgs_learning import paths
from dgs_learning.cli.refusal import refusals

if TYPE_CHECKING:
    from dgs_sim_bridge.render.object_model import ObjectModel


def one_thread_each() -> None:
    """Sums of several threads depend on their number, and the scenes already run in parallel."""
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")  # read when numpy and torch are imported, here and in the workers


def catalogue_of(objects: str, dataset: Path | None) -> tuple[str, list[ObjectModel]]:
    """Name and objects of what `--objects` says."""
    from dgs_learning.dataset import load_dataset
    from dgs_learning.objects.catalogue import train_catalogue
    from dgs_sim_bridge.render.object_model import load_catalogue

    if objects == "train":
        return objects, train_catalogue()
    if objects == "dataset":
        return objects, load_dataset(dataset or paths.dataset_file()).objects
    where = paths.novel_file() if objects == "novel" else Path(objects)
    return ("novel" if objects == "novel" else where.name), load_catalogue(where)


def number_range(words: str) -> tuple[int, int]:
    """A number or two, such as 4-6.

    Raises:
        BadParameter: it is neither.
    """
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
    objects_per_scene: Annotated[
        str, typer.Option(help="A number or a range such as 4-6; empty = 10, with --arm 4-6.")
    ] = "",
    workspace: Annotated[
        tuple[float, float] | None,
        typer.Option(help="Extent in x and y in metres; 0.6 0.6, with --arm 0.4 0.8."),
    ] = None,
    seed: Annotated[
        int, typer.Option(help="The same seed gives the same table on any number of workers.")
    ] = 0,
    proposers: Annotated[
        str, typer.Option(help="Who proposes grasps, separated by commas; empty = the planner that ships.")
    ] = "",
    ablate: Annotated[str, typer.Option(help="none, pre_grasp or offset (Table II).")] = "none",
    without: Annotated[
        list[str] | None,
        typer.Option(
            help="Leave out a stage that follows: contact, check or rank; may be given several times."
        ),
    ] = None,
    model: Annotated[str, typer.Option(help="Name of the weights.")] = "dgs_net",
    models_dir: Annotated[Path | None, typer.Option(help="Where the weights lie.")] = None,
    dataset: Annotated[Path | None, typer.Option(help="Dataset file of random_prior and replay.")] = None,
    workers: Annotated[int, typer.Option(help="Processes; 0 = one per core. --arm clears one by one.")] = 0,
    arm: Annotated[
        bool, typer.Option("--arm/--no-arm", help="Clear with the whole ROS suite instead of a free hand.")
    ] = False,
    speed_up: Annotated[
        float, typer.Option(min=1.0, help="With --arm: simulated seconds per second, where the machine can.")
    ] = 1.0,
) -> None:
    """The paper's clearing protocol in simulation, with a free hand or the robot; writes summary, table and report."""
    one_thread_each()
    from dgs_grasp_planner.planner import SHIPPED
    from dgs_learning.evaluation.proposers import PlannerChoice
    from dgs_learning.evaluation.protocol import Setting
    from dgs_learning.evaluation.report import write_report
    from dgs_learning.evaluation.robot import SuiteFailed, robot_table, run_robot
    from dgs_learning.evaluation.run import run_experiment, table
    from dgs_learning.parallel import process_count

    try:
        count = number_range(objects_per_scene or ("4-6" if arm else "10"))
        area = workspace or ((0.4, 0.8) if arm else (0.6, 0.6))
        setting = Setting(scenes, count, area, seed)
        names = tuple(proposers.split(",")) if proposers else SHIPPED
        choice = PlannerChoice(names, tuple(without or ()), ablate, model, models_dir, dataset)
        with refusals():
            name, catalogue = catalogue_of(objects, dataset)
            if arm:
                typer.echo(robot_table(run_robot(catalogue, name, choice, setting, out, speed_up)))
            else:
                processes = process_count(workers)
                typer.echo(table(run_experiment(catalogue, name, choice, setting, out, processes)))
    except (ValueError, FileNotFoundError) as error:
        raise typer.BadParameter(str(error)) from None
    except SuiteFailed as error:
        typer.echo(str(error), err=True)
        raise typer.Exit(1) from None
    typer.echo(f"report: {write_report([out], out / 'report.html')}")
