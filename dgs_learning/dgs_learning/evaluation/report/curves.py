"""The picture of a training's curves."""

from __future__ import annotations

from pathlib import Path

import matplotlib
from matplotlib.figure import Figure

from dgs_description.errors import DgsError, ErrorCode
from dgs_learning.training.curve import HELD_OUT, read_curve

PANELS = (
    ("loss", "loss", ("loss",)),
    ("points", "precision, recall", ("precision", "recall")),
    ("rotation", "median angle [deg]", ("angle_deg",)),
    ("offset", "median error [mm]", ("offset_mm",)),
    ("final joints", "mean error [rad]", ("j_end_rad",)),
    ("speed", "samples per second", ("samples_per_s",)),
)
COLOURS = ("#0f8b8d", "#c8553d")


def draw_curve(file: Path, target: Path) -> None:
    """Draw `file` into the PNG `target`.

    Raises:
        DgsError: REQUEST_INVALID if there is no such table.
    """
    try:
        splits = read_curve(file)
    except (OSError, ValueError) as error:
        raise DgsError(ErrorCode.REQUEST_INVALID, f"no curves to draw: {error}") from error
    style = {"font.size": 7.5, "axes.grid": True, "grid.color": "#e5e7eb", "legend.frameon": False}
    with matplotlib.rc_context(style):
        figure = Figure(figsize=(7.2, 3.8), layout="constrained")
        axes = figure.subplots(2, 3)
        for panel, (title, label, names) in zip(axes.flat, PANELS, strict=True):
            panel.set(title=title, ylabel=label)
            for split, columns in splits.items():
                measured = split == HELD_OUT
                mark = {"linestyle": "--", "marker": "o", "markersize": 2.5} if measured else {"alpha": 0.85}
                for name, colour in zip(names, COLOURS, strict=False):
                    if name in columns:
                        text = f"{name} {split}" if len(names) > 1 else split
                        panel.plot(columns["step"], columns[name], color=colour, label=text, lw=1.0, **mark)
        axes[0, 0].set_yscale("log")
        for panel in axes[0, :2]:
            panel.legend(fontsize=6)
        for panel in axes[1]:
            panel.set_xlabel("step")
        target.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(target, dpi=100, metadata={"Software": None})
