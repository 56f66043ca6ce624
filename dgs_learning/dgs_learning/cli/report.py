"""`dgs report`: one HTML page from finished runs, and the results block of the README."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dgs_learning import paths


def report(
    runs: Annotated[list[Path] | None, typer.Argument(help="Finished run folders of `dgs evaluate`.")] = None,
    out: Annotated[Path, typer.Option(help="HTML file to write.")] = Path("report.html"),
    gallery: Annotated[int, typer.Option(min=0, help="Attempts drawn per run.")] = 36,
    publish: Annotated[
        bool, typer.Option("--publish", help="Copy the runs' summaries to docs/results.")
    ] = False,
    readme: Annotated[
        bool, typer.Option("--readme", help="Fill the README's results from docs/results.")
    ] = False,
) -> None:
    """Tables beside the paper's, plots and a gallery of finished runs, in one self-contained page."""
    from dgs_learning.evaluation.readme import fill_readme
    from dgs_learning.evaluation.readme import publish as copy_summaries
    from dgs_learning.evaluation.report import write_report

    folders = list(runs or [])
    if not folders and not readme:
        raise typer.BadParameter("name at least one run folder, or --readme")
    results = paths.repository() / "docs" / "results"
    try:
        if folders:
            typer.echo(f"report: {write_report(folders, out, gallery)}")
        if publish:
            for path in copy_summaries(folders, results):
                typer.echo(f"published: {path}")
        if readme:
            changed = fill_readme(paths.repository() / "README.md", results)
            typer.echo("README: results " + ("rewritten" if changed else "unchanged"))
    except (FileNotFoundError, ValueError) as error:
        raise typer.BadParameter(str(error)) from None
