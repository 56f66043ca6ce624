"""Options that several subcommands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

Workers = Annotated[int, typer.Option(help="Processes; 0 = one per core.")]
Seed = Annotated[int, typer.Option(help="The same seed gives the same result on any number of workers.")]
Backend = Annotated[str, typer.Option(help="loky (processes here) or dask.")]
Cluster = Annotated[str, typer.Option(help="Address of a running dask scheduler.")]
Dataset = Annotated[Path | None, typer.Option(help="Dataset file.")]
Json = Annotated[Path | None, typer.Option("--json", help="Write the result here as JSON.")]
Model = Annotated[str, typer.Option(help="Name of the weights.")]
ModelsDir = Annotated[Path | None, typer.Option(help="Where the weights lie.")]
Device = Annotated[str, typer.Option(help="cpu, cuda or auto.")]
Threads = Annotated[int, typer.Option(min=0, help="Torch threads; 0 = torch's default.")]
Physics = Annotated[str, typer.Option("--engine", help="Physics engine: pybullet or mujoco.")]
Friction = Annotated[float | None, typer.Option(min=0.0, help="Of the hand on an object; default: 0.8.")]
