"""Options that several subcommands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

Workers = Annotated[int, typer.Option(min=0, help="Processes; 0 = one per core.")]
Seed = Annotated[
    int, typer.Option(min=0, help="The same seed gives the same result on any number of workers.")
]
Backend = Annotated[Literal["loky", "dask"], typer.Option(help="loky: processes here.")]
Cluster = Annotated[str, typer.Option(help="Address of a running dask scheduler.")]
Dataset = Annotated[Path | None, typer.Option(help="Dataset file.")]
Json = Annotated[Path | None, typer.Option("--json", dir_okay=False, help="Write the result here as JSON.")]
Model = Annotated[str, typer.Option(help="Name of the weights.")]
ModelsDir = Annotated[Path | None, typer.Option(help="Where the weights lie.")]
Device = Annotated[Literal["cpu", "cuda", "auto"], typer.Option(help="Where the network runs.")]
Threads = Annotated[int, typer.Option(min=0, max=64, help="Torch threads; 0 = torch's default.")]
Physics = Annotated[Literal["pybullet", "mujoco"], typer.Option("--engine", help="Physics engine.")]
Doc = Annotated[
    Path | None, typer.Option(exists=True, dir_okay=False, help="Write the table here, between its marks.")
]
Proposers = Annotated[
    str, typer.Option(help="Who proposes grasps, separated by commas; empty = the planner that ships.")
]
Without = Annotated[
    list[str] | None, typer.Option(help="Leave out a stage: contact, check or rank; repeatable.")
]
Only = Annotated[list[str] | None, typer.Option(help="This row; may be given several times.")]
Friction = Annotated[float | None, typer.Option(min=0.0, help="Of the hand on an object; default: 0.8.")]


def number_range(words: str) -> tuple[int, int]:
    """A number or two, such as 4-6.

    Raises:
        BadParameter: it is neither.
    """
    low, _, high = words.partition("-")
    try:
        first, last = int(low), int(high or low)
        if first > last:
            raise ValueError
    except ValueError:
        raise typer.BadParameter(f"{words!r} is neither a number nor a range such as 4-6") from None
    return first, last
