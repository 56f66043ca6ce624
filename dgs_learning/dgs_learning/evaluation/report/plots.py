"""Plots of a report as inline SVG."""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from typing import Any

import matplotlib
import numpy as np

from dgs_learning.evaluation.metrics import FAILURES, wilson
from dgs_learning.evaluation.paper import TABLE_2
from dgs_learning.evaluation.protocol import AttemptRecord
from dgs_sim_bridge.render.object_model import SHAPE_CLASSES

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.figure import Figure

COLOURS = ("#0f8b8d", "#c8553d", "#3d5a98", "#e0a030", "#7d5ba6", "#6b7280")
STYLE = {
    "font.size": 9.0,
    "font.family": "sans-serif",
    "svg.fonttype": "none",
    "svg.hashsalt": "dgs",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#e5e7eb",
    "axes.axisbelow": True,
    "legend.frameon": False,
    "legend.fontsize": 8.0,
}


def _svg(figure: Figure) -> str:
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    plt.close(figure)
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    # Its style sheet holds for the whole page: say the same on the root instead.
    text = re.sub(r"<style[^>]*>.*?</style>", "", text, flags=re.DOTALL)
    text = text.replace("<svg", '<svg stroke-linejoin="round" stroke-linecap="butt"', 1)
    return re.sub(r'(<svg[^>]*?) height="[^"]*"([^>]*?) width="[^"]*"', r"\1\2", text, count=1)


def success_per_class(labels: Sequence[str], summaries: Sequence[dict[str, Any]]) -> str:
    """SR of every class with its 95 % interval, and the paper's."""
    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(figsize=(6.4, 3.0), layout="constrained")
        place = np.arange(len(SHAPE_CLASSES))
        wide = 0.8 / max(1, len(summaries))
        for k, (label, summary) in enumerate(zip(labels, summaries, strict=True)):
            rows = [summary["per_class"][name] for name in SHAPE_CLASSES]
            rate = np.array([row["sr"] for row in rows]) * 100
            bounds = np.array([row["sr_interval"] for row in rows]).T * 100
            known = np.array([row["attempts"] > 0 for row in rows])
            x = (place - 0.4 + wide * (k + 0.5))[known]
            error = np.abs(bounds[:, known] - rate[known])
            colour = COLOURS[k % len(COLOURS)]
            axes.bar(x, rate[known], wide * 0.9, color=colour, alpha=0.85, label=label)
            axes.errorbar(x, rate[known], error, fmt="none", ecolor="#1d2733", elinewidth=1, capsize=2)
        paper = [TABLE_2["none"].per_class[name] * 100 for name in SHAPE_CLASSES]
        axes.plot(place, paper, "k_", markersize=26, label="paper, DGS-Net, 10 objects")
        axes.set_xticks(place, SHAPE_CLASSES)
        axes.set_ylim(0, 105)
        axes.set_ylabel("SR [%]")
        figure.legend(loc="outside upper center", ncols=2)
        return _svg(figure)


def failures(labels: Sequence[str], summaries: Sequence[dict[str, Any]]) -> str:
    """How attempts ended, as shares of all of them."""
    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(figsize=(6.4, 1.2 + 0.38 * len(summaries)), layout="constrained")
        left = np.zeros(len(summaries))
        kinds = ("success", *FAILURES)
        colours = ("#0f8b8d", "#7c2d12", "#9ca3af", "#e0a030", "#c8553d", "#d1d5db")
        total = np.array([max(1, s["successes"] + sum(s["failures"].values())) for s in summaries])
        for kind, colour in zip(kinds, colours, strict=True):
            counts = np.array(
                [s["successes"] if kind == "success" else s["failures"].get(kind, 0) for s in summaries]
            )
            axes.barh(
                np.arange(len(summaries)),
                counts / total * 100,
                left=left,
                color=colour,
                label=kind,
                height=0.6,
            )
            left += counts / total * 100
        axes.set_yticks(np.arange(len(summaries)), labels)
        axes.invert_yaxis()
        axes.set_xlim(0, 100)
        axes.set_xlabel("share of attempts [%]")
        figure.legend(loc="outside upper center", ncols=3)
        return _svg(figure)


def penetration(labels: Sequence[str], attempts: Sequence[Sequence[AttemptRecord]]) -> str:
    """Share of grasps with no more than a penetration: depth and volume of the predicted hand."""
    with plt.rc_context(STYLE):
        figure, pair = plt.subplots(1, 2, figsize=(6.4, 2.8), layout="constrained", sharey=True)
        for axes, name, unit in zip(pair, ("pd_mm", "pv_mm3"), ("PD [mm]", "PV [mm³]"), strict=True):
            for k, (label, own) in enumerate(zip(labels, attempts, strict=True)):
                values = np.sort([getattr(a, name) for a in own if a.executed])
                share = np.arange(1, len(values) + 1) / max(1, len(values)) * 100
                axes.step(values, share, where="post", color=COLOURS[k % len(COLOURS)], label=label)
            axes.set_xlabel(unit)
            axes.set_xlim(left=0)
        pair[0].set_ylabel("share of grasps [%]")
        pair[0].set_ylim(0, 102)
        handles, names = pair[0].get_legend_handles_labels()
        figure.legend(handles, names, loc="outside upper center", ncols=2)
        return _svg(figure)


def calibration(labels: Sequence[str], attempts: Sequence[Sequence[AttemptRecord]]) -> str:
    """SR of the attempts of every range of scores: a score is worth something where the line rises."""
    edges = np.linspace(0.0, 1.0, 6)
    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(figsize=(6.4, 2.8), layout="constrained")
        for k, (label, own) in enumerate(zip(labels, attempts, strict=True)):
            tried = [a for a in own if a.executed]
            rank = np.clip(np.digitize([a.score for a in tried], edges) - 1, 0, 4)
            rows = []
            for level in range(5):
                won = [a.success for a, r in zip(tried, rank, strict=True) if r == level]
                if won:
                    rows.append((edges[level] + 0.1, np.mean(won), *wilson(sum(won), len(won))))
            if rows:
                x, y, low, high = np.array(rows).T
                error = np.abs(np.stack([y - low, high - y])) * 100
                colour = COLOURS[k % len(COLOURS)]
                axes.errorbar(x + 0.008 * k, y * 100, error, fmt="o-", color=colour, capsize=2, label=label)
        axes.set_xlim(0, 1)
        axes.set_ylim(0, 105)
        axes.set_xlabel("score of the executed grasp")
        axes.set_ylabel("SR [%]")
        figure.legend(loc="outside upper center", ncols=2)
        return _svg(figure)
