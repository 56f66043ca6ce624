"""`dgs report`: one HTML page from finished runs, tables of finished experiments in a document, the model card."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dgs_learning import paths
from dgs_learning.cli.refusal import refusals


def report(
    runs: Annotated[
        list[Path],
        typer.Argument(help="Run folders of `dgs evaluate`, or JSON files of `dgs experiment` with --doc."),
    ],
    out: Annotated[Path, typer.Option(help="HTML file to write of the runs.")] = Path("report.html"),
    gallery: Annotated[int, typer.Option(min=0, help="Attempts drawn per run.")] = 36,
    doc: Annotated[
        Path | None, typer.Option(help="Write the experiments' tables here, between their marks.")
    ] = None,
) -> None:
    """Tables beside the paper's, plots and a gallery of finished runs, in one self-contained page."""
    from dgs_learning.evaluation.report.page import write_report
    from dgs_learning.evaluation.report.tables import fill_document, read_result

    try:
        if doc is None:
            typer.echo(f"report: {write_report(runs, out, gallery)}")
            return
        for file in runs:
            changed = fill_document(doc, read_result(file))
            typer.echo(f"{doc}: {file.stem} {'rewritten' if changed else 'unchanged'}")
    except (FileNotFoundError, ValueError) as error:
        raise typer.BadParameter(str(error)) from None


def model_card(
    run: Annotated[
        Path | None,
        typer.Option(help="Training folder (or curve.csv) whose curves are kept with the weights."),
    ] = None,
    model: Annotated[str, typer.Option(help="Name of the weights.")] = "dgs_net",
    models_dir: Annotated[Path | None, typer.Option(help="Where weights and card lie.")] = None,
    dataset: Annotated[Path | None, typer.Option(help="Dataset file.")] = None,
    results: Annotated[Path | None, typer.Option(help="Folder of results of experiments.")] = None,
    speed: Annotated[Path | None, typer.Option(help="Folder of bench-inference results.")] = None,
) -> None:
    """Write the model card README.md beside the weights, with data, configuration, curves, metrics, speed, limits."""
    from dgs_learning.evaluation.report.model_card import CardFiles, write_card

    published = results or paths.repository() / "docs" / "results"
    files = CardFiles(
        models_dir or paths.models_dir(),
        model,
        dataset or paths.dataset_file(),
        published,
        speed or published / "speed",
    )
    with refusals():
        typer.echo(f"model card: {write_card(files, run)}")
