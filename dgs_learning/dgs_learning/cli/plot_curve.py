"""`dgs plot-curve`: the curves of a training (curve.csv) as a small picture."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def plot_curve(
    curve: Annotated[Path, typer.Argument(help="curve.csv of a training folder, or the folder.")],
    out: Annotated[Path | None, typer.Option(help="PNG to write; default: beside the curve.")] = None,
) -> None:
    """Draw the curves: training as lines, held-out scenes as dashed lines with points."""
    from dgs_learning.evaluation.report.curves import draw_curve

    file = curve / "curve.csv" if curve.is_dir() else curve
    target = out or file.with_suffix(".png")
    draw_curve(file, target)
    typer.echo(f"{target} ({target.stat().st_size / 1e3:.0f} kB)")
