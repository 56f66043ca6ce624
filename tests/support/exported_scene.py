"""Reads an exported scene back."""

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


@dataclass(frozen=True)
class GraspTable:
    """grasp_labels.txt, G grasps: the columns that docs/dataset.md names; position (G, 3), j_init (G, 20) and so on."""

    instance: NDArray[np.int64]
    fingers: NDArray[np.int64]
    source: NDArray[np.int64]
    symmetry: NDArray[np.int64]
    position: Array
    quaternion: Array
    j_init: Array
    j_end: Array


def read_grasps(path: Path) -> GraspTable:
    """What `layout.write_grasps` wrote."""
    columns = np.split(np.loadtxt(path, ndmin=2).reshape(-1, 51), [1, 2, 3, 4, 7, 11, 31], axis=1)
    instance, fingers, source, symmetry = (column[:, 0].astype(np.int64) for column in columns[:4])
    return GraspTable(instance, fingers, source, symmetry, *columns[4:])


class ExportedScene:
    """One scene folder.

    Attributes:
        camera: intrinsics.
        T_table_camera: (V, 4, 4) viewpoints.
        objects: name, class, family, scale, mass, x, y, z [m], qx, qy, qz, qw in the frame *table* of each, as words.
        grasps: all feasible grasps in the frame *table*.
        visible: (V, N) visible share of every object in every view.
    """

    def __init__(self, path: Path):
        """`path`: of the folder."""
        self.path = path
        info = dict(line.split() for line in (path / "cam_info.txt").read_text().splitlines())
        assert int(info["layout_version"]) == layout.VERSION
        numbers = (float(info[key]) for key in ("fx", "fy", "cx", "cy"))
        self.camera = PinholeCamera(int(info["width"]), int(info["height"]), *numbers)
        self.T_table_camera = np.loadtxt(path / "cam_extrinsic.txt", ndmin=2)[:, 1:].reshape(-1, 4, 4)
        lines = (path / "obj_info.txt").read_text().splitlines()
        self.objects = [line.split()[1:] for line in lines if not line.startswith("#")]
        self.grasps = read_grasps(path / "grasp_labels.txt")
        self.visible = np.loadtxt(path / "visible_mask.txt", ndmin=2)

    def view(self, number: int) -> ExportedView:
        """All files of a viewpoint."""
        arrays: dict[str, NDArray] = {}
        for folder in ("pointcloud", "grasp"):
            with np.load(layout.view_file(self.path, folder, number), allow_pickle=False) as data:
                arrays |= {name: data[name] for name in data.files}
        rgb, depth, segn = (
            cv2.imread(str(layout.view_file(self.path, folder, number)), cv2.IMREAD_UNCHANGED)
            for folder in ("rgb", "depth", "segn")
        )
        metres = depth.astype(np.float32) * np.float32(layout.DEPTH_UNIT)
        return ExportedView(rgb[..., ::-1], metres, segn, self.T_table_camera[number], **arrays)
