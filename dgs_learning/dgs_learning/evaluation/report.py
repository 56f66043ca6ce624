"""One self-contained HTML page from finished runs: tables beside the paper's, plots, attempts with failures first."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined, select_autoescape

from dgs_learning.evaluation import paper
from dgs_learning.evaluation.metrics import FAILURES
from dgs_learning.evaluation.protocol import AttemptRecord, SceneResult
from dgs_learning.evaluation.records import load_cloud, load_scene
from dgs_learning.evaluation.robot_metrics import AFTER_LIFT, ARM_FAILURES, GRASP_FAILURES, UNREACHABLE
from dgs_learning.evaluation.robot_report import RobotRun
from dgs_sim_bridge.render.object_model import SHAPE_CLASSES

GALLERY = 36
"""Attempts drawn per run, failures first."""
GOOD_SHARE = 1 / 3
"""Share of the gallery that is kept for successes."""

PLANNER_NAMES = {
    "dgs_net": "DGS-Net",
    "top_down": "geometric top-down",
    "random_prior": "random prior",
    "replay": "replay of stored grasps",
}
ABLATION_NAMES = {"none": "", "pre_grasp": " without pre-grasp", "offset": " without offset"}


def planner_label(setting: dict[str, Any]) -> str:
    """Name of planner and ablation of a summary's setting."""
    name = PLANNER_NAMES.get(setting["planner"], setting["planner"])
    left_out = "".join(f", no {stage}" for stage in setting.get("without", ()))
    return name + left_out + ABLATION_NAMES.get(setting["ablate"], f" ({setting['ablate']})")


def setting_label(summary: dict[str, Any]) -> str:
    """Scenes, objects and workspace of a summary in words."""
    setting = summary["setting"]
    low, high = setting["objects_per_scene"]
    count = str(low) if low == high else f"{low}-{high}"
    x, y = setting["area"]
    return f"{summary['scenes']} scenes of {count} objects ({setting['objects']['name']}) in {x:g} x {y:g} m"


@dataclass(frozen=True)
class Run:
    """A finished run.

    Attributes:
        folder: of the run.
        summary: its `summary.json`.
    """

    folder: Path
    summary: dict[str, Any]

    @cached_property
    def scenes(self) -> list[SceneResult]:
        """All scenes."""
        return [load_scene(self.folder, n)[0] for n in range(self.summary["scenes"])]

    @cached_property
    def attempts(self) -> list[AttemptRecord]:
        """All attempts in order."""
        return [a for scene in self.scenes for a in scene.attempts]

    @property
    def label(self) -> str:
        """Planner."""
        return planner_label(self.summary["setting"])

    @property
    def setting(self) -> str:
        """Scenes, objects, workspace."""
        return setting_label(self.summary)

    def gallery(self, size: int = GALLERY) -> list[AttemptRecord]:
        """Attempts to draw: failures by kind in turn, then successes from the lowest score on."""
        good = sorted((a for a in self.attempts if a.success), key=lambda a: a.score)
        kinds = [[a for a in self.attempts if a.outcome == kind] for kind in FAILURES]
        depth = max((len(kind) for kind in kinds), default=0)
        bad = [kind[k] for k in range(depth) for kind in kinds if k < len(kind)]
        bad = bad[: max(size - len(good), round(size * (1 - GOOD_SHARE)))]
        return bad + good[: size - len(bad)]


def load_run(folder: Path) -> Run | RobotRun:
    """A finished run, of a free hand or of the robot.

    Raises:
        FileNotFoundError: the folder has no summary: the run is not finished.
    """
    file = folder / "summary.json"
    if not file.is_file():
        raise FileNotFoundError(f"{folder} has no summary.json: it is no finished run of `dgs evaluate`")
    summary = json.loads(file.read_text())
    kind = RobotRun if summary["setting"].get("protocol") == "robot" else Run
    return kind(folder, summary)


def _percent(value: float | None, digits: int = 1) -> str:
    return "–" if value is None else f"{value * 100:.{digits}f}"


def _number(value: float | None, digits: int = 2) -> str:
    return "–" if value is None else f"{value:.{digits}f}"


def _large(value: float) -> str:
    return f"{value:.0f}" if value < 1e5 else f"{value:.2g}".replace("e+0", "e")


def _interval(pair: Sequence[float]) -> str:
    return f"{pair[0] * 100:.1f}–{pair[1] * 100:.1f}"


def _environment() -> Environment:
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent / "templates"),
        autoescape=select_autoescape(["html", "j2"], default=True),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"percent": _percent, "number": _number, "large": _large, "interval": _interval}
    return environment


def render(finished: Sequence[Run | RobotRun], gallery: int = GALLERY) -> str:
    """The page as text."""
    from dgs_learning.evaluation.drawing import draw_attempt

    runs = [run for run in finished if isinstance(run, Run)]
    robots = [run for run in finished if isinstance(run, RobotRun)]
    labels = _distinct([(run.label, run.folder.name) for run in runs])
    drawn = [
        [(a, draw_attempt(a, load_cloud(run.folder, a.scene, a.attempt))) for a in run.gallery(gallery)]
        for run in runs
    ]
    robot_labels = _distinct([("DGS-Net", run.folder.name) for run in robots])
    return (
        _environment()
        .get_template("report.html.j2")
        .render(
            runs=list(zip(labels, runs, drawn, strict=True)),
            robots=list(zip(robot_labels, robots, strict=True)),
            settings=list(zip([*labels, *robot_labels], [*runs, *robots], strict=True)),
            classes=SHAPE_CLASSES,
            failures=FAILURES,
            grasp_failures=GRASP_FAILURES,
            arm_failures=ARM_FAILURES,
            after_lift=AFTER_LIFT,
            unreachable=UNREACHABLE,
            paper=paper,
            plots=_plots(labels, runs) if runs else {},
        )
    )


def _plots(labels: Sequence[str], runs: Sequence[Run]) -> dict[str, str]:
    from dgs_learning.evaluation import plots

    summaries, attempts = [run.summary for run in runs], [run.attempts for run in runs]
    return {
        "classes": plots.success_per_class(labels, summaries),
        "failures": plots.failures(labels, summaries),
        "penetration": plots.penetration(labels, attempts),
        "calibration": plots.calibration(labels, attempts),
    }


def _distinct(named: Sequence[tuple[str, str]]) -> list[str]:
    """Names, with the folder's where they would be the same."""
    names = [name for name, _ in named]
    return [name if names.count(name) == 1 else f"{name}, {folder}" for name, folder in named]


def write_report(folders: Sequence[Path], target: Path, gallery: int = GALLERY) -> Path:
    """Write the page of finished runs to `target` and return it.

    Raises:
        FileNotFoundError: one of the folders is no finished run.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text(render([load_run(folder) for folder in folders], gallery), encoding="utf-8")
    return target
