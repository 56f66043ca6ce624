"""Files of an exported scene: names, values and text formats (docs/dataset.md describes them)."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from dgs_description.camera import PinholeCamera
from dgs_description.frames import Array, to_quaternion
from dgs_description.grasp import GraspSet
from dgs_learning.objects.catalogue import name_and_scale
from dgs_sim_bridge.render.d455 import D455Noise
from dgs_sim_bridge.render.object_model import ObjectModel

VERSION = 1
"""Raised when a file changes its meaning."""
FOLDERS = {"rgb": "png", "depth": "png", "pointcloud": "npz", "segn": "png", "grasp": "npz"}
"""One file per viewpoint in each of them, `0000` and so on, with this suffix."""
DEPTH_UNIT = 0.001
"""Of the 16-bit depth images [m]."""
SEGN_NOTHING, SEGN_TABLE, SEGN_FIRST_OBJECT = 0, 1, 2
"""Values of the segmentation images: nothing, table, object 0; object k has `SEGN_FIRST_OBJECT` + k."""


def word(name: str) -> str:
    """A name as one word of a table, or one folder of a path."""
    return re.sub(r"[\s/\\]+", "_", name)


def view_file(scene: Path, folder: str, view: int) -> Path:
    """Path of a viewpoint's file."""
    return scene / folder / f"{view:04d}.{FOLDERS[folder]}"


def write_camera(scene: Path, camera: PinholeCamera) -> None:
    """cam_info.txt: a name and a value per line."""
    values = {"layout_version": VERSION, **asdict(camera)}
    values |= {"baseline": D455Noise.baseline, "depth_unit": DEPTH_UNIT}
    (scene / "cam_info.txt").write_text("".join(f"{key} {value}\n" for key, value in values.items()))


def write_extrinsics(scene: Path, T_table_camera: Sequence[Array]) -> None:
    """cam_extrinsic.txt: a line per viewpoint, its number and T_table_camera row by row."""
    rows = [[k, *T.ravel()] for k, T in enumerate(T_table_camera)]
    header = "view, then T_table_camera (4x4) row by row: pose of the optical frame in the frame table [m]"
    np.savetxt(scene / "cam_extrinsic.txt", rows, fmt=["%d", *["%.9f"] * 16], header=header)


def write_objects(scene: Path, models: Sequence[ObjectModel], T_table_object: Array) -> None:
    """obj_info.txt: a line per object; (N, 4, 4) poses."""
    lines = ["# instance name class family scale mass[kg] x y z[m] qx qy qz qw (pose in the frame table)"]
    for k, (model, T) in enumerate(zip(models, T_table_object, strict=True)):
        name, scale = name_and_scale(model.name)
        pose = " ".join(f"{value:.7f}" for value in np.concatenate(to_quaternion(T)))
        kind = f"{word(name)} {model.shape_class} {word(model.family)}"
        lines.append(f"{k} {kind} {scale:.2f} {model.mass:.4f} {pose}")
    (scene / "obj_info.txt").write_text("\n".join(lines) + "\n")


def write_grasps(path: Path, grasps: GraspSet, instance: NDArray, source: NDArray, symmetry: NDArray) -> None:
    """grasp_labels.txt: a line per grasp.

    Args:
        grasps: G of them, in the frame *table* (of a scene) or the object's.
        instance: (G,) object of the scene.
        source: (G,) number of the stage-1 grasp of its object.
        symmetry: (G,) turn by which that grasp was multiplied; 0 = none.
    """
    quaternion = Rotation.from_matrix(grasps.rotation).as_quat()
    joints = grasps.pre_grasp_joints, grasps.grasp_joints
    numbers = instance, grasps.active_fingers.sum(axis=1), source, symmetry
    table = np.column_stack([*numbers, grasps.position, quaternion, *joints])
    count = grasps.grasp_joints.shape[1]
    shapes = f"pre-grasp joints x {count} [rad]  final joints x {count} [rad]"
    header = f"instance fingers source symmetry  x y z [m]  qx qy qz qw  {shapes}"
    np.savetxt(path, table, fmt=["%d"] * 4 + ["%.6f"] * (7 + 2 * count), header=header)


def write_visibility(scene: Path, share: Array) -> None:
    """visible_mask.txt: a line per viewpoint, a column per object: visible share of its silhouette, 0 = hidden."""
    unseen = "0 = hidden or outside the image"
    header = f"per viewpoint and object: visible share of the object's silhouette ({unseen})"
    np.savetxt(scene / "visible_mask.txt", share, fmt="%.4f", header=header)
