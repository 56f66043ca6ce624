"""Options that several subcommands share."""

from __future__ import annotations

from typing import Annotated

import typer

Workers = Annotated[int, typer.Option(help="Processes; 0 = one per core.")]
Seed = Annotated[int, typer.Option(help="The same seed gives the same result on any number of workers.")]
Backend = Annotated[str, typer.Option(help="loky (processes here) or dask.")]
Cluster = Annotated[str, typer.Option(help="Address of a running dask scheduler.")]
