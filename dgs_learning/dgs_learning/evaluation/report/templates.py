"""Fills the templates of pages, tables and cards; the words and number formats that they share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import yaml
from jinja2 import Environment, FileSystemLoader, StrictUndefined

from dgs_grasp_planner.planner import SHIPPED, STAGES

FOLDER = Path(__file__).parent
NAMES = {
    "dgs_net": "DGS-Net",
    "level_pinch": "level pinches",
    "edge_pinch": "edge pinches",
    "turn_over": "turns over",
    "drag": "drags",
    "push": "pushes",
    "part": "partings",
    "top_down": "geometric top-down",
    "random_prior": "random prior",
    "replay": "stored grasps",
}
"""Of proposers, in tables."""


def read_data(name: str) -> Any:
    """The contents of a YAML file of this package, e.g. the paper's tables."""
    return yaml.safe_load((FOLDER / f"{name}.yaml").read_text(encoding="utf-8"))


def planner_label(setting: Mapping[str, Any]) -> str:
    """Proposers and stages of a summary's setting; the network without further words is the network alone."""
    proposers, stages = setting["proposers"], setting["stages"]
    label = " + ".join([*(NAMES.get(name, name) for name in proposers), *stages])
    if (tuple(proposers), tuple(stages)) == (SHIPPED, STAGES):
        label = f"planner ({label})"
    return label if setting["ablate"] == "none" else f"{label}, without {setting['ablate']}"


def setting_label(summary: Mapping[str, Any]) -> str:
    """Scenes, objects and workspace of a summary in words."""
    setting = summary["setting"]
    low, high = setting["objects_per_scene"]
    count = str(low) if low == high else f"{low}-{high}"
    x, y = setting["area"]
    who = "simulated robot, " if setting.get("protocol") == "robot" else ""
    who += "rehearsed without ROS, " if setting.get("rehearsal") else ""
    return f"{who}{summary['scenes']} scenes of {count} objects ({setting['objects']['name']}) in {x:g} x {y:g} m"


def options(summaries: Sequence[Mapping[str, Any]]) -> str:
    """Scenes and seed, where they are the same in all summaries, as a command takes them."""
    values = {"scenes": {s["scenes"] for s in summaries}, "seed": {s["setting"]["seed"] for s in summaries}}
    return "".join(f" --{name} {same.pop()}" for name, same in values.items() if len(same) == 1)


def percent(value: float | None, digits: int = 1) -> str:
    """A rate in percent."""
    return "–" if value is None else f"{value * 100:.{digits}f}"


def number(value: float | None, digits: int = 2) -> str:
    """A number with so many digits behind the point."""
    return "–" if value is None else f"{value:.{digits}f}"


def large(value: float) -> str:
    """A number that may be very large, short."""
    return f"{value:.0f}" if value < 1e5 else f"{value:.2g}".replace("e+0", "e")


def interval(pair: Sequence[float]) -> str:
    """Two rates in percent."""
    return f"{pair[0] * 100:.1f}–{pair[1] * 100:.1f}"


def counted(counts: Mapping[str, int], nothing: str = "–") -> str:
    """What occurred, and how often."""
    return ", ".join(f"{name} {count}" for name, count in counts.items() if count) or nothing


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=FileSystemLoader(FOLDER / "templates"),
        autoescape=lambda name: ".html" in (name or ""),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    formats = (planner_label, setting_label, options, percent, number, large, interval, counted)
    environment.filters |= {f.__name__: f for f in formats}
    return environment


def render(template: str, **values: Any) -> str:
    """The text of a template of this package, without a last line break."""
    return _environment().get_template(f"{template}.j2").render(**values).strip()
