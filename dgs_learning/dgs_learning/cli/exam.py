"""`dgs exam`: the experiment `exam`, on novel and household objects and on a folder of scanned real ones."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import typer

from dgs_learning.cli.evaluate import evaluation
from dgs_learning.cli.experiment import run_experiment
from dgs_learning.cli.files import write_json
from dgs_learning.cli.options import Doc, Json, Only, Proposers, Without, Workers
from dgs_learning.cli.refusal import refuse

RUNS = Path("runs/exam")


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
    out: Annotated[Path, typer.Option(help="Folder of the runs; unfinished ones in it go on.")] = RUNS,
    workers: Workers = 0,
    json_file: Json = None,
    doc: Doc = None,
) -> None:
    """Sit the exam: {novel, household, real} x {PyBullet, MuJoCo} x {new, worn}, each split by how the objects lie."""
    if real is not None and not real.is_dir():
        refuse(f"there is no folder {real}")
    with evaluation():
        from dgs_learning.evaluation.experiment import read_experiment
        from dgs_learning.evaluation.report.tables import exam_rows

        changes: dict[str, object] = {"scenes": scenes, "seed": seed, "without": tuple(without or ())}
        if proposers:
            changes["proposers"] = tuple(proposers.split(","))
        wanted = read_experiment("exam", changes, (), only or ())
        folder = "" if real is None else f"{real}@{part}".removesuffix("@all")
        rows = [replace(row, objects=folder) if row.objects == "real" else row for row in wanted.rows]
        rows = [row for row in rows if row.objects]
        if not rows:
            refuse("rows of real objects need their folder: --real FOLDER")
        result = run_experiment(replace(wanted, rows=tuple(rows)), out, workers, doc)
        write_json(json_file, exam_rows(result))
