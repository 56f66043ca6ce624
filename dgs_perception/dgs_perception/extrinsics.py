"""The camera's pose in `base_link`: read from and written to a YAML file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import (
    BASE_LINK,
    CAMERA_OPTICAL,
    T_CAMERA_LINK_OPTICAL,
    Array,
    from_quaternion,
    inverse,
    to_quaternion,
)

MAX_DISTANCE = 10.0
"""A camera farther than this from the robot is taken for a wrong unit [m]."""
QUATERNION_TOLERANCE = 1e-3
"""How far the norm of a quaternion may be from 1: rounding in a hand-written file, not a slip."""
KEYS = ("parent", "child", "position", "quaternion_xyzw")


@dataclass(frozen=True, eq=False)
class Extrinsics:
    """Pose of the depth camera.

    Attributes:
        optical_frame: name of the frame that depth images and clouds carry (x right, y down, z forward).
        T_base_camera_optical: (4, 4) its pose in `base_link`.
    """

    optical_frame: str
    T_base_camera_optical: Array

    @property
    def T_base_camera_link(self) -> Array:
        """(4, 4) pose of `camera_link` (x forward, y left, z up), from which realsense-ros hangs all its frames."""
        return self.T_base_camera_optical @ inverse(T_CAMERA_LINK_OPTICAL)


def load_extrinsics(path: Path | str) -> Extrinsics:
    """Read and check a file such as `config/extrinsics.yaml`.

    Raises:
        DgsError: EXTRINSICS_INVALID, with the path and what is wrong, a position beyond `MAX_DISTANCE` included.
    """
    path = Path(path)
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise _invalid(path, f"cannot be read: {error}") from error
    except yaml.YAMLError as error:
        raise _invalid(path, f"is not YAML: {error}") from error
    entry = content.get("T_base_camera_optical") if isinstance(content, dict) else None
    if not isinstance(entry, dict) or set(content) != {"T_base_camera_optical"}:
        raise _invalid(path, "must hold one mapping `T_base_camera_optical`")
    if set(entry) != set(KEYS):
        raise _invalid(path, f"must have the keys {', '.join(KEYS)}, not {', '.join(map(str, entry))}")
    if entry["parent"] != BASE_LINK:
        raise _invalid(path, f"has the parent {entry['parent']!r}; the pose must be given in {BASE_LINK!r}")
    if not isinstance(entry["child"], str) or not entry["child"].strip("/ "):
        raise _invalid(path, f"has the child {entry['child']!r}; it must be the name of the optical frame")
    try:
        T_base_camera = read_pose(entry)
    except ValueError as error:
        raise _invalid(path, str(error)) from error
    if np.linalg.norm(T_base_camera[:3, 3]) > MAX_DISTANCE:
        far = f"puts the camera at {entry['position']}, over {MAX_DISTANCE:g} m away"
        raise _invalid(path, f"{far}; the unit is metres")
    return Extrinsics(entry["child"], T_base_camera)


def save_extrinsics(path: Path | str, T_base_camera_optical: Array) -> None:
    """Write a pose (4, 4) of the optical frame in `base_link` as a file that `load_extrinsics` reads."""
    position, quaternion = to_quaternion(T_base_camera_optical)
    lines = [
        "# Pose of the depth camera's optical frame (x right, y down, z forward) in the robot's base_link.",
        "# position [m], unit quaternion x y z w. Replace it by the result of your hand-eye calibration.",
        "T_base_camera_optical:",
        f"  parent: {BASE_LINK}",
        f"  child: {CAMERA_OPTICAL}",
        f"  position: [{', '.join(f'{value:.9f}' for value in position)}]",
        f"  quaternion_xyzw: [{', '.join(f'{value:.12f}' for value in quaternion)}]",
    ]
    Path(path).write_text("\n".join(lines) + "\n", encoding="utf-8")


def read_pose(entry: dict[str, Any]) -> Array:
    """(4, 4) pose of a mapping with `position` [m] and unit `quaternion_xyzw`. Raises ValueError: "has ..."."""
    values = []
    for key, count in (("position", 3), ("quaternion_xyzw", 4)):
        try:
            numbers = np.array(entry.get(key), float)
        except (TypeError, ValueError):
            numbers = np.empty(0)
        if numbers.shape != (count,) or not np.isfinite(numbers).all():
            raise ValueError(f"has {key} {entry.get(key)!r}; it must be {count} finite numbers")
        values.append(numbers)
    position, quaternion = values
    norm = float(np.linalg.norm(quaternion))
    if abs(norm - 1.0) > QUATERNION_TOLERANCE:
        raise ValueError(f"has a quaternion of norm {norm:.4f}; it must be 1")
    return from_quaternion(position, quaternion / norm)


def _invalid(path: Path, what: str) -> DgsError:
    return DgsError(ErrorCode.EXTRINSICS_INVALID, f"The extrinsics file {path} {what}.")
