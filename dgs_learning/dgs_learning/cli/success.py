"""`dgs trials` and `dgs fit-success`: execute candidates, and fit to them how likely a grasp holds."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from dgs_learning.cli.options import Doc, Json, Seed, Workers, number_range


def trials(
    out: Annotated[
        Path, typer.Option(file_okay=False, help="Folder; scenes that are in it are not tried again.")
    ],
    objects: Annotated[
        str, typer.Option(help="train, everyday, a folder of objects, or a part of it (PATH@train).")
    ] = "train",
    scenes: Annotated[str, typer.Option(help="From scene A to before scene B: A-B.")] = "0-100",
    seed: Seed = 9100,
    workers: Workers = 0,
) -> None:
    """Execute the planner's candidates, likely and others, in both engines, with hardware new and worn."""
    from dgs_learning.cli.refusal import refusals
    from dgs_learning.evaluation.trials import run_trials
    from dgs_learning.parallel import Engine

    first, last = number_range(scenes)
    if first == last:
        raise typer.BadParameter(
            f"no scene is from {first} to before {last}: name two numbers, such as 0-100"
        )
    with refusals(ValueError):
        count = run_trials(objects, (first, last), seed, out, Engine(workers))
    typer.echo(f"{count} candidates executed, in {out}")


def fit_success(
    folders: Annotated[list[Path], typer.Argument(help="Folders of `dgs trials`.")],
    out: Annotated[
        Path | None, typer.Option(dir_okay=False, help="Write the model here instead of into the planner.")
    ] = None,
    json_file: Json = None,
    doc: Doc = None,
) -> None:
    """Fit the planner's ranking to trials, after it was judged on scenes held out."""
    from dgs_description.files import atomic_write
    from dgs_description.paths import today
    from dgs_grasp_planner.success import FILE
    from dgs_learning.cli.files import put_out
    from dgs_learning.cli.refusal import refusals
    from dgs_learning.evaluation.success_fit import fit_success as fit
    from dgs_learning.evaluation.success_fit import judge
    from dgs_learning.evaluation.trials import load_trials

    with refusals(ValueError):
        tried = load_trials(folders)
    judged = judge(tried) | {"date": today()}
    with atomic_write(out or FILE, "w") as file:
        file.write(json.dumps(fit(tried), indent=1) + "\n")
    put_out("success.md", judged, json_file, doc)
