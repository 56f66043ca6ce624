"""Plots of a report as data URIs."""

from __future__ import annotations

import base64
import io
import textwrap
from collections.abc import Callable, Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from dgs_learning.evaluation.metrics import FAILURES, wilson
from dgs_learning.evaluation.protocol import AttemptRecord
from dgs_learning.evaluation.report.templates import read_data
from dgs_sim_bridge.render.object_model import SHAPE_CLASSES

OUTCOME_COLOURS = ("#0f8b8d", "#7c2d12", "#9ca3af", "#e0a030", "#c8553d", "#d1d5db")
COLOURS = ("#0f8b8d", "#c8553d", "#3d5a98", "#e0a030", "#7d5ba6", "#6b7280")
STYLE = {
    "font.size": 9.0,
    "axes.prop_cycle": matplotlib.cycler(color=COLOURS),
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#e5e7eb",
    "axes.axisbelow": True,
    "legend.frameon": False,
    "legend.fontsize": 8.0,
    "svg.hashsalt": "dgs",
}
Runs = Sequence[tuple[str, dict[str, Any], Sequence[AttemptRecord]]]
"""Label, summary and attempts of every run."""


def draw_all(runs: Runs) -> dict[str, str]:
    """All plots of some runs, by name."""
    every: tuple[Callable[[Runs], Figure], ...] = (success_per_class, failures, penetration, calibration)
    short = [(textwrap.fill(label, 36), summary, attempts) for label, summary, attempts in runs]
    with matplotlib.rc_context(STYLE):
        return {draw.__name__: _data_uri(draw(short)) for draw in every}


def _data_uri(figure: Figure) -> str:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    return "data:image/svg+xml;base64," + base64.b64encode(buffer.getvalue()).decode()


def _figure(runs: Runs, columns: int = 1) -> tuple[Figure, Any]:
    """A figure with room for the labels of all runs, and its axes."""
    figure = Figure(figsize=(6.4, 2.6 + 0.3 * len(runs)), layout="constrained")
    return figure, figure.subplots(1, columns, sharey=True)


def _errors(rate: ArrayLike, intervals: Sequence[Sequence[float]]) -> np.ndarray:
    """Lengths (2, N) of error bars in percent."""
    return np.abs(np.array(intervals).reshape(-1, 2).T - np.array(rate)) * 100


def success_per_class(runs: Runs) -> Figure:
    """SR of every class with its 95 % interval, and the paper's."""
    figure, axes = _figure(runs)
    wide = 0.8 / max(1, len(runs))
    for k, (label, summary, _) in enumerate(runs):
        rows = [summary["per_class"][name] for name in SHAPE_CLASSES]
        known = [i for i, row in enumerate(rows) if row["attempts"]]
        rate = np.array([rows[i]["sr"] for i in known])
        errors = _errors(rate, [rows[i]["sr_interval"] for i in known])
        x = np.array(known) - 0.4 + wide * (k + 0.5)
        axes.bar(x, rate * 100, wide * 0.9, yerr=errors, capsize=2, alpha=0.85, label=label)
    (paper,) = (row for row in read_data("paper")["table_2"] if row["ablate"] == "none")
    shown = [paper["per_class"][name] * 100 for name in SHAPE_CLASSES]
    axes.plot(shown, "k_", markersize=26, label="paper, DGS-Net, 10 objects")
    axes.set_xticks(range(len(SHAPE_CLASSES)), SHAPE_CLASSES)
    axes.set(ylim=(0, 105), ylabel="SR [%]")
    figure.legend(loc="outside upper center", ncols=2)
    return figure


def failures(runs: Runs) -> Figure:
    """How attempts ended, as shares of all of them."""
    figure, axes = _figure(runs)
    counts = np.array([[s["successes"], *(s["failures"][kind] for kind in FAILURES)] for _, s, _ in runs])
    share = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1) * 100
    start = np.cumsum(share, axis=1) - share
    for k, kind in enumerate(("success", *FAILURES)):
        axes.barh(range(len(runs)), share[:, k], 0.6, start[:, k], color=OUTCOME_COLOURS[k], label=kind)
    axes.set_yticks(range(len(runs)), [label for label, *_ in runs])
    axes.invert_yaxis()
    axes.set(xlim=(0, 100), xlabel="share of attempts [%]")
    figure.legend(loc="outside upper center", ncols=3)
    return figure


def penetration(runs: Runs) -> Figure:
    """Share of grasps with no more than a penetration: depth and volume of the predicted hand."""
    figure, pair = _figure(runs, 2)
    for axes, name, unit in zip(pair, ("pd_mm", "pv_mm3"), ("PD [mm]", "PV [mm³]"), strict=True):
        for label, _, attempts in runs:
            values = [getattr(a, name) for a in attempts if a.executed]
            if values:
                axes.ecdf(values, label=label if axes is pair[0] else None)
        axes.set_xlabel(unit)
        axes.set_xlim(left=0)
    pair[0].set_ylabel("share of grasps")
    if pair[0].lines:  # somebody grasped
        figure.legend(loc="outside upper center", ncols=2)
    return figure


def calibration(runs: Runs) -> Figure:
    """SR of the attempts of every fifth of the scores: a score is worth something where the line rises."""
    figure, axes = _figure(runs)
    for label, _, attempts in runs:
        tried = [a for a in attempts if a.executed]
        groups = [[a.success for a in tried if min(int(a.score * 5), 4) == k] for k in range(5)]
        x = [0.2 * k + 0.1 for k in range(5) if groups[k]]
        rate = [float(np.mean(won)) for won in groups if won]
        errors = _errors(rate, [wilson(sum(won), len(won)) for won in groups if won])
        axes.errorbar(x, np.array(rate) * 100, errors, fmt="o-", capsize=2, label=label)
    axes.set(xlim=(0, 1), ylim=(0, 105), xlabel="score of the executed grasp", ylabel="SR [%]")
    figure.legend(loc="outside upper center", ncols=2)
    return figure
