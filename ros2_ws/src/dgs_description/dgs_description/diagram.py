"""Draws the default hand and its frames, from the URDF's numbers: `python -m dgs_description.diagram [FILE.png]`."""

from __future__ import annotations

import sys
from argparse import ArgumentParser
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Polygon, Rectangle
from scipy.spatial import ConvexHull

from dgs_description.frames import Array, apply
from dgs_description.hand import CHOICE, DEFAULT, HAND

AXIS_COLOURS = ("#d62728", "#2ca02c", "#1f4fd8")
FINGER_COLOURS = ("#e8b04b", "#8fb8de", "#9fd0a8", "#c9a9d6", "#e3a3a0")
POSTURE = np.concatenate(
    [HAND.spread[:, None], np.tile([0.20, 0.30, 0.30], (HAND.finger_count, 1))], axis=1
).ravel()
"""Yaw spread, slightly flexed [rad]."""
AXIS_LENGTH = 0.045
VIEWS = (
    ("palm view (seen from +x)", (1, 2), ("y: to the thumb's side", "z: to the fingertips = approach")),
    (
        "side view (seen from the little finger)",
        (0, 2),
        ("x: out of the palm", "z: to the fingertips = approach"),
    ),
)
"""Title, the two axes of hand_base that are drawn, their labels."""


def draw(path: Path) -> None:
    """Write the picture as PNG."""
    figure, panels = plt.subplots(1, 2, figsize=(10.5, 6.4), dpi=100, sharey=True)
    for panel, (title, axes, labels) in zip(panels, VIEWS, strict=True):
        _draw_palm(panel, axes)
        _draw_fingers(panel, axes)
        _draw_frame(panel, axes, -HAND.T_mount_base[:3, 3], "tool0 = hand_mount", 0.3, (-0.02, -0.012))
        _draw_frame(panel, axes, np.zeros(3), "hand_base", 0.7, (0.006, -0.010))
        _draw_frame(panel, axes, HAND.T_base_tcp[:3, 3], "hand_tcp", 1.0, (0.006, -0.011))
        panel.set_title(title, fontsize=11)
        panel.set_xlabel(f"{labels[0]}  [m in hand_base]", fontsize=9)
        panel.set_ylabel(f"{labels[1]}  [m in hand_base]", fontsize=9)
        panel.tick_params(labelsize=8, labelleft=True)
        panel.set_aspect("equal")
        panel.set_xlim(-0.095, 0.145)
        panel.set_ylim(-0.05, 0.235)
        panel.grid(alpha=0.2)
    x, y, z = (1e3 * HAND.T_base_tcp[:3, 3]).round(1)
    tcp = f"hand_tcp at ({x:g}, {y:g}, {z:g}) mm in hand_base, same axes"
    figure.suptitle(f"DexHand Pro, right hand: {tcp}", fontsize=11)
    figure.tight_layout()
    path.parent.mkdir(parents=True, exist_ok=True)
    # No time stamp or version inside: the same numbers give the same file.
    figure.savefig(path, metadata={"Software": None})
    plt.close(figure)


def _draw_palm(panel: Axes, axes: tuple[int, int]) -> None:
    for box in HAND.palm_boxes:
        low, size = box[::2], box[1::2] - box[::2]
        corner, (width, height) = low[list(axes)], size[list(axes)]
        panel.add_patch(Rectangle(corner, width, height, facecolor="#d8d8dc", edgecolor="#9a9aa2", lw=0.6))


def _draw_fingers(panel: Axes, axes: tuple[int, int]) -> None:
    frames = HAND.link_frames(POSTURE)
    tips = HAND.fingertips(POSTURE) + HAND.T_base_tcp[:3, 3]
    # What is nearer to the viewer is drawn later.
    depth = 3 - sum(axes)
    sign = 1 if depth == 0 else -1
    for f in np.argsort(sign * tips[:, depth]):
        for k, capsule in enumerate(HAND.capsules[0]):
            ends = np.array([[0, capsule.start, capsule.height], [0, capsule.end, capsule.height]])
            points = apply(frames[f, k + 1], ends) + HAND.T_base_tcp[:3, 3]
            outline = _capsule_outline(points[:, list(axes)], capsule.radius)
            panel.add_patch(
                Polygon(outline, facecolor=FINGER_COLOURS[f], edgecolor="#555555", lw=0.6, zorder=3)
            )
        tip = tips[f, list(axes)]
        panel.plot(*tip, "o", color="#333333", ms=3, zorder=6)
        if depth == 0 or HAND.fingers[f] in ("thumb", "little", "middle"):
            # In the palm view the thumb lies in front of the index finger: its name goes to its side.
            shift, align = ((18, 4), "left") if f == 0 else ((0, 13), "center")
            panel.annotate(
                HAND.fingers[f], tip, xytext=shift, textcoords="offset points", ha=align, fontsize=9, zorder=9
            )


def _capsule_outline(ends: Array, radius: float) -> Array:
    """(V, 2) outline of the projection of a capsule with the ends (2, 2) [m]."""
    angle = np.linspace(0, 2 * np.pi, 64, endpoint=False)
    circle = radius * np.column_stack([np.cos(angle), np.sin(angle)])
    points = (ends[:, None] + circle).reshape(-1, 2)
    return points[ConvexHull(points).vertices]


def _draw_frame(
    panel: Axes, axes: tuple[int, int], origin: Array, name: str, alpha: float, shift: tuple[float, float]
) -> None:
    at = origin[list(axes)]
    for axis in axes:
        tip = at + AXIS_LENGTH * np.eye(3)[axis][list(axes)]
        colour = AXIS_COLOURS[axis]
        arrow = {"arrowstyle": "-|>", "color": colour, "lw": 2.2, "alpha": alpha}
        panel.annotate("", tip, xytext=at, arrowprops=arrow, zorder=10)
        if alpha == 1.0:
            panel.text(*(tip + 0.004), "xyz"[axis], color=colour, fontsize=11, weight="bold", zorder=11)
    panel.plot(*at, "o", color="black", ms=4, alpha=alpha, zorder=11)
    white = {"facecolor": "white", "alpha": 0.7, "edgecolor": "none", "pad": 1.0}
    panel.text(*(at + shift), name, fontsize=9, zorder=9, bbox=white)


if __name__ == "__main__":
    parser = ArgumentParser(description="Draw the hand's frames.")
    parser.add_argument("picture", type=Path, nargs="?", default=Path("docs/images/hand_frames.png"))
    target = parser.parse_args().picture
    if HAND.name != DEFAULT:
        sys.exit(f"views and words are those of the default hand: unset {CHOICE}")
    draw(target)
    print(f"wrote {target}")
