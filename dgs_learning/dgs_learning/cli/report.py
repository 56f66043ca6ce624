"""`dgs report`: a page of finished runs, or tables of experiments; `dgs plot-curve`: the curves of a training."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def report(
    runs: Annotated[list[Path], typer.Argument(help="Run folders; with --doc, results of `dgs experiment`.")],
    out: Annotated[Path, typer.Option(dir_okay=False, help="HTML file to write of the runs.")] = Path(
        "report.html"
    ),
    gallery: Annotated[int, typer.Option(min=0, help="Attempts drawn per run.")] = 36,
    doc: Annotated[Path | None, typer.Option(help="Write the tables here, between their marks.")] = None,
) -> None:
    """Tables beside the paper's, plots and a gallery of finished runs, in one self-contained page."""
    from dgs_learning.cli.refusal import refusals
    from dgs_learning.evaluation.report.page import write_report
    from dgs_learning.evaluation.report.tables import fill_document, read_result

    with refusals(FileNotFoundError, ValueError):
        if doc is None:
            typer.echo(f"report: {write_report(runs, out, gallery)}")
            return
        for file in runs:
            changed = fill_document(doc, read_result(file))
            typer.echo(f"{doc}: {file.stem} {'rewritten' if changed else 'unchanged'}")


def plot_curve(
    curve: Annotated[Path, typer.Argument(help="curve.csv of a training folder, or the folder.")],
    out: Annotated[
        Path | None, typer.Option(dir_okay=False, help="PNG to write; default: beside the curve.")
    ] = None,
) -> None:
    """Draw the curves: training as lines, held-out scenes as dashed lines with points."""
    from dgs_learning.evaluation.report.curves import draw_curve

    file = curve / "curve.csv" if curve.is_dir() else curve
    target = out or file.with_suffix(".png")
    draw_curve(file, target)
    typer.echo(f"{target} ({target.stat().st_size / 1e3:.0f} kB)")
