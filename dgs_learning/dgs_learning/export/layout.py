"""Files of an exported scene: names, text formats, and the types they hold (docs/dataset.md describes them)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dgs_description.camera import PinholeCamera
from dgs_sim_bridge.render.d455 import D455Noise

Array = NDArray[np.float64]

VERSION = 1
"""Raised when a file changes its meaning."""
FOLDERS = {"rgb": "png", "depth": "png", "pointcloud": "npz", "segn": "png", "grasp": "npz"}
"""One file per viewpoint in each of them, `0000` and so on, with this suffix."""
DEPTH_UNIT = 0.001
"""Of the 16-bit depth images [m]."""
SEGN_NOTHING, SEGN_TABLE, SEGN_FIRST_OBJECT = 0, 1, 2
"""Values of the segmentation images: nothing, table, object 0; object k has `SEGN_FIRST_OBJECT` + k."""


@dataclass(frozen=True)
class SceneObject:
    """One line of obj_info.txt: object of the scene, pose as position [m] and quaternion xyzw in the frame *table*."""

    instance: int
    name: str
    shape_class: str
    family: str
    scale: float
    mass: float
    position: tuple[float, float, float]
    quaternion: tuple[float, float, float, float]


@dataclass(frozen=True)
class GraspTable:
    """grasp_labels.txt: G feasible grasps in the frame *table*.

    Attributes:
        instance: (G,) object of the scene, fingers: (G,) 5, 3 or 2.
        source: (G,) number of the stage-1 grasp of its object.
        symmetry: (G,) turn by which that grasp was multiplied; 0 = none.
        position: (G, 3) TCP [m], quaternion: (G, 4) xyzw.
        j_init, j_end: (G, 20) pre-grasp and final joints [rad].
    """

    instance: NDArray[np.int64]
    fingers: NDArray[np.int64]
    source: NDArray[np.int64]
    symmetry: NDArray[np.int64]
    position: Array
    quaternion: Array
    j_init: Array
    j_end: Array

    def __len__(self) -> int:
        return len(self.instance)


def view_file(scene: Path, folder: str, view: int) -> Path:
    """Path of a viewpoint's file."""
    return scene / folder / f"{view:04d}.{FOLDERS[folder]}"


def write_camera(scene: Path, camera: PinholeCamera) -> None:
    """cam_info.txt: a name and a value per line."""
    values = {"layout_version": VERSION, **asdict(camera)}
    values |= {"baseline": D455Noise.baseline, "depth_unit": DEPTH_UNIT}
    (scene / "cam_info.txt").write_text("".join(f"{key} {value}\n" for key, value in values.items()))


def read_camera(scene: Path) -> PinholeCamera:
    """The camera of a scene.

    Raises:
        ValueError: the scene has another version of the layout.
    """
    words = dict(line.split() for line in (scene / "cam_info.txt").read_text().splitlines())
    if int(words["layout_version"]) != VERSION:
        raise ValueError(
            f"{scene} has layout version {words['layout_version']}, this program reads {VERSION}"
        )
    numbers = (float(words[key]) for key in ("fx", "fy", "cx", "cy"))
    return PinholeCamera(int(words["width"]), int(words["height"]), *numbers)


def write_extrinsics(scene: Path, T_table_camera: Sequence[Array]) -> None:
    """cam_extrinsic.txt: a line per viewpoint, its number and T_table_camera row by row."""
    rows = [[k, *T.ravel()] for k, T in enumerate(T_table_camera)]
    header = "view, then T_table_camera (4x4) row by row: pose of the optical frame in the frame table [m]"
    np.savetxt(scene / "cam_extrinsic.txt", rows, fmt=["%d", *["%.9f"] * 16], header=header)


def read_extrinsics(scene: Path) -> Array:
    """(V, 4, 4) T_table_camera."""
    return np.loadtxt(scene / "cam_extrinsic.txt", ndmin=2)[:, 1:].reshape(-1, 4, 4)


def write_objects(scene: Path, objects: Sequence[SceneObject]) -> None:
    """obj_info.txt."""
    lines = ["# instance name class family scale mass[kg] x y z[m] qx qy qz qw (pose in the frame table)"]
    for o in objects:
        numbers = " ".join(f"{v:.7f}" for v in (*o.position, *o.quaternion))
        lines.append(f"{o.instance} {o.name} {o.shape_class} {o.family} {o.scale:.2f} {o.mass:.4f} {numbers}")
    (scene / "obj_info.txt").write_text("\n".join(lines) + "\n")


def read_objects(scene: Path) -> list[SceneObject]:
    """Objects of a scene."""
    objects = []
    for line in (scene / "obj_info.txt").read_text().splitlines():
        if not line.startswith("#"):
            instance, name, shape_class, family, scale, mass, *pose = line.split()
            x, y, z, qx, qy, qz, qw = (float(word) for word in pose)
            objects.append(
                SceneObject(
                    int(instance),
                    name,
                    shape_class,
                    family,
                    float(scale),
                    float(mass),
                    (x, y, z),
                    (qx, qy, qz, qw),
                )
            )
    return objects


_GRASP_COLUMNS = (("instance", 1), ("fingers", 1), ("source", 1), ("symmetry", 1)) + (
    ("position", 3),
    ("quaternion", 4),
    ("j_init", 20),
    ("j_end", 20),
)


def write_grasps(path: Path, grasps: GraspTable) -> None:
    """grasp_labels.txt: a line per grasp."""
    table = np.concatenate(
        [np.asarray(getattr(grasps, n)).reshape(len(grasps), w) for n, w in _GRASP_COLUMNS], axis=1
    )
    header = (
        "instance fingers source symmetry  x y z [m]  qx qy qz qw  "
        "pre-grasp joints x 20 [rad]  final joints x 20 [rad]"
    )
    np.savetxt(path, table, fmt=["%d"] * 4 + ["%.6f"] * 47, header=header)


def read_grasps(path: Path) -> GraspTable:
    """What `write_grasps` wrote."""
    lines = [line for line in path.read_text().splitlines() if not line.startswith("#")]
    table = np.array([[float(word) for word in line.split()] for line in lines]).reshape(-1, 51)
    columns: dict[str, Any] = {}
    start = 0
    for name, width in _GRASP_COLUMNS:
        values = table[:, start : start + width]
        columns[name] = values[:, 0].astype(np.int64) if width == 1 else values
        start += width
    return GraspTable(**columns)


def write_visibility(scene: Path, share: Array) -> None:
    """visible_mask.txt: a line per viewpoint, a column per object: visible share of its silhouette, 0 = hidden."""
    header = (
        "per viewpoint and object: visible share of the object's silhouette (0 = hidden or outside the image)"
    )
    np.savetxt(scene / "visible_mask.txt", share, fmt="%.4f", header=header)


def read_visibility(scene: Path) -> Array:
    """(V, N) visible shares."""
    return np.loadtxt(scene / "visible_mask.txt", ndmin=2)
