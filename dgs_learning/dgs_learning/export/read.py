"""Reads an exported scene back: for training with other code, and for tests."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from dgs_description.camera import PinholeCamera
from dgs_learning.export import layout

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ExportedView:
    """One viewpoint; clouds and grasps in the camera's optical frame.

    Attributes:
        rgb: (H, W, 3) uint8, depth: (H, W) float32 [m] with noise, 0 = none, segn: (H, W) uint8.
        T_table_camera: (4, 4).
        points: (N, 3) float32 [m], instance: (N,) object, -1 = table.
        label: (N,) 0 not graspable, 1 candidate, 2 reference.
        grasp: (G,) row of grasp_labels.txt, point: (G,) row of its reference point.
        offset, position: (G, 3) [m], rotation: (G, 3, 3), j_init, j_end: (G, 20) [rad].
    """

    rgb: NDArray[np.uint8]
    depth: NDArray[np.float32]
    segn: NDArray[np.uint8]
    T_table_camera: Array
    points: NDArray[np.float32]
    instance: NDArray[np.int16]
    label: NDArray[np.uint8]
    grasp: NDArray[np.int32]
    point: NDArray[np.int32]
    offset: NDArray[np.float32]
    position: NDArray[np.float32]
    rotation: NDArray[np.float32]
    j_init: NDArray[np.float32]
    j_end: NDArray[np.float32]


class ExportedScene:
    """One scene folder.

    Attributes:
        path: of the folder.
        camera: intrinsics.
        T_table_camera: (V, 4, 4) viewpoints.
        objects: what lies on the table.
        grasps: all feasible grasps in the frame *table*.
        visible: (V, N) visible share of every object in every view.
    """

    def __init__(self, path: Path):
        self.path = path
        self.camera: PinholeCamera = layout.read_camera(path)
        self.T_table_camera = layout.read_extrinsics(path)
        self.objects = layout.read_objects(path)
        self.grasps = layout.read_grasps(path / "grasp_labels.txt")
        self.visible = layout.read_visibility(path)

    def __len__(self) -> int:
        return len(self.T_table_camera)

    def view(self, number: int) -> ExportedView:
        """All files of a viewpoint."""
        arrays: dict[str, NDArray] = {}
        for folder in ("pointcloud", "grasp"):
            with np.load(layout.view_file(self.path, folder, number), allow_pickle=False) as data:
                arrays |= {name: data[name] for name in data.files}
        depth = self._image("depth", number).astype(np.float32) * np.float32(layout.DEPTH_UNIT)
        return ExportedView(
            rgb=self._image("rgb", number)[..., ::-1],
            depth=depth,
            segn=self._image("segn", number),
            T_table_camera=self.T_table_camera[number],
            **arrays,
        )

    def _image(self, folder: str, number: int) -> NDArray:
        path = layout.view_file(self.path, folder, number)
        pixels = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        if pixels is None:
            raise FileNotFoundError(f"{path} is missing or is no image")
        return pixels
