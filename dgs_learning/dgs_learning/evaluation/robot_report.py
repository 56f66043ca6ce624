"""What the report page shows of a run of the robot protocol: figures, and pictures of every scene."""

from __future__ import annotations

import base64
import io
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from PIL import Image

from dgs_learning.evaluation.robot import load_robot_scene, scene_folder

WIDTH = 420
"""Of a picture in the page [px]."""


@dataclass(frozen=True)
class ScenePictures:
    """One scene of the gallery.

    Attributes:
        number: of the scene.
        summary: its `summary.json`.
        before, after: pictures as data URIs: camera image with the predicted hands, and the table at the end; empty
            where the demo left none.
    """

    number: int
    summary: dict[str, Any]
    before: str
    after: str

    @property
    def cleared(self) -> bool:
        """Whether nothing was left."""
        return bool(self.summary["cleared"] == self.summary["objects"])


@dataclass(frozen=True)
class RobotRun:
    """A finished run of the robot protocol.

    Attributes:
        folder: of the run.
        summary: its `summary.json`.
    """

    folder: Path
    summary: dict[str, Any]

    @property
    def setting(self) -> str:
        """Scenes, objects, workspace."""
        return robot_setting_label(self.summary)

    @cached_property
    def scenes(self) -> list[ScenePictures]:
        """All scenes: those with the most objects left first, then those with the most failures."""

        def rank(scene: ScenePictures) -> tuple[int, int, int]:
            s = scene.summary
            return s["cleared"] - s["objects"], s["successes"] - s["attempts"], scene.number

        return sorted((self._scene(n) for n in range(self.summary["scenes"])), key=rank)

    def _scene(self, number: int) -> ScenePictures:
        folder = scene_folder(self.folder, number)
        pictures = (_data_uri(folder / name) for name in ("grasps_camera.png", "after.png"))
        return ScenePictures(number, load_robot_scene(self.folder, number), *pictures)


def robot_setting_label(summary: dict[str, Any]) -> str:
    """Scenes, objects and workspace of a summary in words."""
    setting = summary["setting"]
    low, high = setting["objects_per_scene"]
    x, y = setting["area"]
    count = str(low) if low == high else f"{low}-{high}"
    return (
        f"simulated robot, {summary['scenes']} scenes of {count} objects ({setting['objects']['name']}) "
        f"in {x:g} x {y:g} m, {summary['attempts']} attempts"
    )


def _data_uri(path: Path) -> str:
    """A picture, made small, as text for a page; empty if there is none."""
    if not path.is_file():
        return ""
    buffer = io.BytesIO()
    with Image.open(path) as image:
        size = (WIDTH, round(WIDTH * image.height / image.width))
        image.convert("RGB").resize(size, Image.Resampling.LANCZOS).save(buffer, "JPEG", quality=80)
    return "data:image/jpeg;base64," + base64.b64encode(buffer.getvalue()).decode()
