"""`dgs evaluate`: the paper's clearing protocol, one run."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from dgs_learning import paths
from dgs_learning.cli.options import (
    Friction,
    Model,
    ModelsDir,
    Physics,
    Proposers,
    Seed,
    Without,
    number_range,
)
from dgs_learning.cli.refusal import refusals

SUITE_FAILED_EXIT = 1


@contextmanager
def evaluation() -> Iterator[None]:
    """The evaluation's surroundings: one thread per process, and an end with a sentence for what cannot be run."""
    for name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        # Sums of several threads depend on their number, and the scenes already run in parallel.
        os.environ.setdefault(name, "1")  # read when torch is imported, here and in the workers
    from dgs_learning.evaluation.robot import SuiteFailed

    try:
        with refusals(ValueError, FileNotFoundError):
            yield
    except SuiteFailed as error:
        typer.echo(str(error), err=True)
        raise typer.Exit(SUITE_FAILED_EXIT) from None


def evaluate(
    out: Annotated[
        Path, typer.Option(file_okay=False, help="Folder of the results; an unfinished run in it goes on.")
    ],
    objects: Annotated[
        str,
        typer.Option(
            help="novel, household, train, everyday, dataset (of --dataset), a catalogue file, or a folder "
            "in the import format; @train or @held_out behind it takes that part."
        ),
    ] = "novel",
    scenes: Annotated[int, typer.Option(min=1, help="Number of scenes.")] = 10,
    objects_per_scene: Annotated[
        str, typer.Option(help="A number or a range such as 4-6; empty = 10, with --arm 4-6.")
    ] = "",
    workspace: Annotated[
        tuple[float, float] | None,
        typer.Option(help="Extent in x and y in metres; 0.6 0.6, with --arm the cell's."),
    ] = None,
    seed: Seed = 0,
    proposers: Proposers = "",
    without: Without = None,
    ablate: Annotated[
        str, typer.Option(help="Take away what the proposers say: none, pre_grasp or offset (Table II).")
    ] = "none",
    model: Model = "dgs_net",
    models_dir: ModelsDir = None,
    dataset: Annotated[Path | None, typer.Option(help="Of stored grasps and their objects.")] = None,
    engine: Physics = "pybullet",
    friction: Friction = None,
    worn: Annotated[
        bool,
        typer.Option(
            "--worn/--new", help="Worn hand, camera a little off, objects of other mass and friction."
        ),
    ] = False,
    transparent: Annotated[
        float, typer.Option(min=0.0, max=1.0, help="This share of every scene's objects is glass.")
    ] = 0.0,
    depth_from: Annotated[
        str,
        typer.Option(help="raw, completed (a network fills in glass), stereo, or a stereo network (.onnx)."),
    ] = "raw",
    workers: Annotated[
        int, typer.Option(min=0, help="Processes; 0 = one per core. --arm clears one by one.")
    ] = 0,
    arm: Annotated[
        bool, typer.Option("--arm/--no-arm", help="Clear with the whole ROS suite instead of a free hand.")
    ] = False,
    speed_up: Annotated[
        float,
        typer.Option(
            min=0.1,
            help="With --arm: simulated seconds per second, where the machine can; below 1 on a busy one.",
        ),
    ] = 1.0,
    overlap: Annotated[
        bool,
        typer.Option(
            "--overlap/--one-by-one",
            help="With --arm: prepare the next pick while the arm carries, or after it.",
        ),
    ] = True,
    rehearse: Annotated[
        bool,
        typer.Option(
            "--rehearse/--suite",
            help="With --arm: the same parts in one process without ROS, ten times as fast, or the suite.",
        ),
    ] = False,
) -> None:
    """The paper's clearing protocol in simulation, with a free hand or the robot; writes summary, table and report."""
    with evaluation():
        from dgs_description.cell import CELL
        from dgs_grasp_planner.planner import SHIPPED
        from dgs_learning.evaluation.conditions import Condition
        from dgs_learning.evaluation.experiment import Row
        from dgs_learning.evaluation.report.page import write_report
        from dgs_learning.evaluation.report.templates import render
        from dgs_learning.evaluation.run import run_row

        row = Row(
            out.name,
            proposers=tuple(proposers.split(",")) if proposers else SHIPPED,
            without=tuple(without or ()),
            ablate=ablate,
            weights=str((models_dir or paths.weights_dir()).resolve() / model),
            dataset=str(dataset or ""),
            objects=objects,
            objects_per_scene=number_range(objects_per_scene or ("4-6" if arm else "10")),
            workspace=workspace or (CELL.workspace_size if arm else (0.6, 0.6)),
            scenes=scenes,
            seed=seed,
            engine=engine,
            condition=Condition(friction=friction, worn=worn, transparent=transparent, depth_from=depth_from),
            arm=arm,
            speed_up=speed_up,
            overlap=overlap,
            rehearse=rehearse,
        )
        summary = run_row(row, out, workers)
        typer.echo(render("robot.txt" if arm else "run.txt", s=summary))
        typer.echo(f"report: {write_report([out], out / 'report.html')}")
