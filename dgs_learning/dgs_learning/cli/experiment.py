"""`dgs experiment`: runs all rows of an experiment that is described in a YAML file; `dgs exam`: those of the exam."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from dgs_learning.cli.evaluate import evaluation
from dgs_learning.cli.files import write_json
from dgs_learning.cli.options import Doc, Json, Only, Proposers, Without, Workers
from dgs_learning.cli.refusal import refuse

if TYPE_CHECKING:
    from dgs_learning.evaluation.experiment import Experiment

EXAM_RUNS = Path("runs/exam")


def experiment(
    which: Annotated[str, typer.Argument(metavar="NAME|FILE", help="A shipped experiment, or a file.")],
    scenes: Annotated[int | None, typer.Option(min=1, help="Scenes per row; default: the file's.")] = None,
    seed: Annotated[
        int | None, typer.Option(min=0, help="The same in every row; default: the file's.")
    ] = None,
    objects: Annotated[str | None, typer.Option(help="As in `dgs evaluate`; default: the file's.")] = None,
    weights: Annotated[list[str] | None, typer.Option(help="FOLDER/NAME; several times: each.")] = None,
    dataset: Annotated[str | None, typer.Option(help="For proposers that use stored grasps.")] = None,
    only: Only = None,
    out: Annotated[
        Path | None, typer.Option(file_okay=False, help="Folder of the runs; unfinished ones go on.")
    ] = None,
    workers: Workers = 0,
    json_file: Json = None,
    doc: Doc = None,
) -> None:
    """Run the rows of an experiment, one after the other, on the same scenes; ends with one table and one report."""
    with evaluation():
        from dgs_learning.evaluation.experiment import read_experiment

        given = {"scenes": scenes, "seed": seed, "objects": objects, "dataset": dataset}
        changes = {key: value for key, value in given.items() if value is not None}
        wanted = read_experiment(which, changes, weights or (), only or ())
        write_json(json_file, run_experiment(wanted, out or Path("runs") / wanted.name, workers, doc))


def exam(
    real: Annotated[
        Path | None,
        typer.Option(
            help="Folder of real objects in the import format; without it, novel and household objects."
        ),
    ] = None,
    part: Annotated[Literal["held_out", "train", "all"], typer.Option(help="Of the folder.")] = "held_out",
    scenes: Annotated[int, typer.Option(min=1, help="Scenes per row, of 10 objects.")] = 20,
    seed: Annotated[int, typer.Option(min=0, help="The same scenes in both engines.")] = 500,
    proposers: Proposers = "",
    without: Without = None,
    only: Only = None,
    out: Annotated[
        Path, typer.Option(file_okay=False, help="Folder of the runs; unfinished ones in it go on.")
    ] = EXAM_RUNS,
    workers: Workers = 0,
    json_file: Json = None,
    doc: Doc = None,
) -> None:
    """Sit the exam: {novel, household, real} x {PyBullet, MuJoCo} x {new, worn}, each split by how the objects lie."""
    if real is not None and not real.is_dir():
        refuse(f"there is no folder {real}")
    with evaluation():
        from dgs_learning.evaluation.experiment import read_experiment

        changes: dict[str, object] = {"scenes": scenes, "seed": seed, "without": tuple(without or ())}
        if proposers:
            changes["proposers"] = tuple(proposers.split(","))
        wanted = read_experiment("exam", changes, (), only or ())
        folder = "" if real is None else f"{real}@{part}".removesuffix("@all")
        rows = [replace(row, objects=folder) if row.objects == "real" else row for row in wanted.rows]
        rows = [row for row in rows if row.objects]
        if not rows:
            refuse("rows of real objects need their folder: --real FOLDER")
        write_json(json_file, run_experiment(replace(wanted, rows=tuple(rows)), out, workers, doc))


def run_experiment(wanted: Experiment, folder: Path, workers: int, doc: Path | None) -> dict[str, Any]:
    """Run or finish every row in a folder of its own; print the table and put it into a document. Returns the rows."""
    from dgs_learning.evaluation.report.page import write_report
    from dgs_learning.evaluation.report.tables import experiment_result, experiment_table, fill_document
    from dgs_learning.evaluation.run import check_row, run_row

    for row in wanted.rows:  # hours may pass until it is the last one's turn
        check_row(row)
    summaries = []
    for row in wanted.rows:
        typer.echo(f"== {row.name}: {row.text or ' + '.join((*row.proposers, *row.stages))}")
        summaries.append(run_row(row, folder / row.name, workers))
    result = experiment_result(wanted, summaries)
    typer.echo(experiment_table(result))
    typer.echo(f"report: {write_report([folder / row.name for row in wanted.rows], folder / 'report.html')}")
    if doc is not None:
        fill_document(doc, result)
    return result
