"""One self-contained HTML page from finished runs: tables beside the paper's, plots, attempts with failures first."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from dgs_learning.evaluation.metrics import FAILURES
from dgs_learning.evaluation.protocol import AttemptRecord
from dgs_learning.evaluation.records import failure_file, load_cloud, load_scene
from dgs_learning.evaluation.report import plots
from dgs_learning.evaluation.report.pictures import data_uri, draw_attempt, picture_file
from dgs_learning.evaluation.report.templates import planner_label, read_data, render
from dgs_learning.evaluation.robot import load_robot_scene, scene_folder
from dgs_learning.evaluation.robot_metrics import AFTER_LIFT, ARM_FAILURES, GRASP_FAILURES, UNREACHABLE
from dgs_sim_bridge.render.object_model import SHAPE_CLASSES

GALLERY = 36
"""Attempts drawn per run, failures first."""
GOOD_SHARE = 1 / 3
"""Share of the gallery that is kept for successes."""
FAILURE_PICTURES = 3
"""Of one object, at most."""


@dataclass(frozen=True)
class Run:
    """A finished run of a free hand or of the robot, and its `summary.json`."""

    folder: Path
    summary: dict[str, Any]

    @property
    def robot(self) -> bool:
        """Whether the whole suite cleared the scenes."""
        return bool(self.summary["setting"].get("protocol") == "robot")

    @cached_property
    def attempts(self) -> list[AttemptRecord]:
        """All attempts of a free hand in order."""
        scenes = range(self.summary["scenes"])
        return [attempt for n in scenes for attempt in load_scene(self.folder, n)[0].attempts]

    def gallery(self, size: int) -> list[AttemptRecord]:
        """Attempts to draw: failures by kind in turn, then successes from the lowest score on."""
        good = sorted((a for a in self.attempts if a.success), key=lambda a: a.score)
        kinds = [[a for a in self.attempts if a.outcome == kind] for kind in FAILURES]
        depth = max((len(kind) for kind in kinds), default=0)
        bad = [kind[k] for k in range(depth) for kind in kinds if k < len(kind)]
        bad = bad[: max(size - len(good), round(size * (1 - GOOD_SHARE)))]
        return bad + good[: size - len(bad)]

    def drawn(self, size: int) -> list[tuple[AttemptRecord, str]]:
        """The gallery with its pictures."""
        clouds = ((a, load_cloud(self.folder, a.scene, a.attempt)) for a in self.gallery(size))
        return [(attempt, draw_attempt(attempt, cloud)) for attempt, cloud in clouds]

    def losses(self) -> list[tuple[dict[str, Any], list[str]]]:
        """What the summary says of every object that was lost, the worst first, with pictures of its failures."""
        files: dict[str, list[Path]] = {}
        for a in self.attempts:
            file = failure_file(self.folder, a.scene, a.attempt)
            if file.is_file() and not a.success:
                files.setdefault(a.object_name, []).append(file)
        return [
            (row, [data_uri(file.read_bytes()) for file in files.get(row["object"], [])[:FAILURE_PICTURES]])
            for row in self.summary.get("losses", [])
        ]

    def robot_scenes(self) -> list[dict[str, Any]]:
        """Summary and pictures of the robot's scenes: most objects left first, then most failures."""
        scenes = [{**load_robot_scene(self.folder, k), "number": k} for k in range(self.summary["scenes"])]
        for scene in scenes:
            folder = scene_folder(self.folder, scene["number"])
            scene["before"] = picture_file(folder / "grasps_camera.png")
            scene["after"] = picture_file(folder / "after.png")
        return sorted(scenes, key=lambda s: (s["cleared"] - s["objects"], s["successes"] - s["attempts"]))


def load_run(folder: Path) -> Run:
    """A finished run.

    Raises:
        FileNotFoundError: the folder has no summary: the run is not finished.
    """
    file = folder / "summary.json"
    if not file.is_file():
        raise FileNotFoundError(f"{folder} has no summary.json: it is no finished run of `dgs evaluate`")
    return Run(folder, json.loads(file.read_text()))


def write_report(folders: Sequence[Path], target: Path, gallery: int = GALLERY) -> Path:
    """Write the page of finished runs to `target` and return it.

    Raises:
        FileNotFoundError: one of the folders is no finished run.
    """
    every = [load_run(folder) for folder in folders]
    labels = [planner_label(run.summary["setting"]) for run in every]
    # Runs of the same planner are told apart by their folders.
    named = [
        (label if labels.count(label) == 1 else f"{label}, {run.folder.name}", run)
        for label, run in zip(labels, every, strict=True)
    ]
    free = [(label, run) for label, run in named if not run.robot]
    page = render(
        "report.html",
        settings=named,
        runs=[(label, run, run.drawn(gallery)) for label, run in free],
        robots=[(label, run) for label, run in named if run.robot],
        classes=SHAPE_CLASSES,
        failures=FAILURES,
        grasp_failures=GRASP_FAILURES,
        arm_failures=ARM_FAILURES,
        after_lift=AFTER_LIFT,
        unreachable=UNREACHABLE,
        paper=read_data("paper"),
        plots=plots.draw_all([(label, run.summary, run.attempts) for label, run in free]) if free else {},
    )
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text(page + "\n", encoding="utf-8")
    return target
