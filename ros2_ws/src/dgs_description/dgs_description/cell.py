"""`CELL`: where things stand around the robot, all in `base_link`; one cell for all processes.

The environment variable `DGS_CELL` names a YAML file with what is different from the defaults (docs/cell.md).
"""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from dgs_description.errors import DgsError, ErrorCode
from dgs_description.files import atomic_write
from dgs_description.frames import (
    BASE_LINK,
    CAMERA_LINK,
    CAMERA_OPTICAL,
    T_CAMERA_LINK_OPTICAL,
    Array,
    apply,
    from_quaternion,
    inverse,
    look_at,
    to_quaternion,
    transform,
)
from dgs_description.joints import ARM_LOWER, ARM_UPPER
from dgs_description.yaml_text import load_yaml

CHOICE = "DGS_CELL"
MAX_DISTANCE = 10.0
"""A camera farther than this from robot or workspace is taken for a wrong unit [m]."""
QUATERNION_TOLERANCE = 1e-3
"""How far the norm of a quaternion may be from 1: rounding in a hand-written file, not a slip."""

_BELOW = 0.02
"""Clouds and the TCP's box reach so far below the table top [m]."""
OVERHANG = 0.08
"""What sticks out over the table's edge is looked at so far [m]."""
BEYOND = 0.10
"""What reaches out of the workspace, but not towards the robot, is looked at so far [m]."""


@dataclass(frozen=True)
class Cell:
    """Where table, workspace, bin and camera stand in `base_link` [m], and how the arm stands at home.

    The robot stands on a pedestal at the long side of the table.
    """

    table_height: float = -0.20
    """z of the table top: the base stands this far above it (see docs/cell.md for the reach scan)."""
    table_size: tuple[float, float, float] = (0.70, 1.10, 0.04)
    """x, y extent and thickness of the table top."""
    table_centre: tuple[float, float] = (0.38, 0.0)
    free_edge: tuple[float, float] = (0.12, 0.40)
    """y where the edge beside the robot is free: the arm reaches beyond it, and nothing of it is seen there [m]."""
    turning_edge: tuple[float, float] = (0.29, 0.35)
    """y where the arm also turns over what sticks out: nearer it meets itself, farther it does not reach [m]."""
    workspace_size: tuple[float, float] = (0.40, 0.80)
    """x, y extent of the area that is cleared."""
    workspace_centre: tuple[float, float] = (0.30, 0.0)
    workspace_height: float = 0.30
    """How far above the table points are kept."""
    floor_height: float = -0.92
    """z of the floor: beneath what sticks out over the table's edge there is room for a hand."""
    pedestal_radius: float = 0.064
    bin_size: tuple[float, float, float] = (0.30, 0.24, 0.15)
    """Outer x, y, z of the open box that takes the objects."""
    bin_centre: tuple[float, float] = (-0.10, -0.42)
    bin_wall: float = 0.006
    camera_distance: float = 1.0
    camera_elevation: float = float(np.deg2rad(62.0))
    """Elevation of the camera above the table plane, seen from the workspace centre [rad]."""
    camera_position: tuple[float, float, float] | None = None
    camera_quaternion_xyzw: tuple[float, float, float, float] | None = None
    """Pose of the optical frame as it was measured, instead of distance and elevation."""
    optical_frame: str = CAMERA_OPTICAL
    """Name of the frame that depth images and clouds carry (x right, y down, z forward)."""
    home: tuple[float, ...] = tuple(round(math.radians(angle), 6) for angle in (-100, -110, 100, -80, -90, 0))
    """Arm joints at home [rad]: hand beside the bin, no part of the arm between camera and workspace."""
    tcp_lower: tuple[float, float] = (-0.70, -0.70)
    tcp_upper: tuple[float, float, float] = (0.70, 0.70, 1.00)
    """Corners of the box that the TCP stays in; its bottom is just below the table top."""

    def __post_init__(self) -> None:
        """Raises ValueError where the parts cannot be so."""
        sizes = *self.table_size, *self.workspace_size, self.workspace_height, *self.bin_size, self.bin_wall
        if min(*sizes, self.pedestal_radius, self.camera_distance) <= 0:
            raise ValueError("sizes and distances must be greater than 0")
        if self.floor_height >= min(0.0, self.table_height - self.table_size[2]):
            raise ValueError("the floor must lie below robot and table top: floor_height")
        lower, upper = self.tcp_bounds
        for low, high in (self.free_edge, self.turning_edge, *zip(lower, upper, strict=True)):
            if low >= high:
                raise ValueError(
                    f"{low:g} must be less than {high:g}: free_edge, turning_edge, tcp_lower, tcp_upper"
                )
        aside = np.abs(np.subtract(self.workspace_centre, self.table_centre)) + np.divide(
            self.workspace_size, 2
        )
        if (aside > np.divide(self.table_size[:2], 2) + 1e-9).any():
            raise ValueError("the workspace must lie on the table")
        if np.abs(np.subtract(self.free_edge, self.table_centre[1])).max() > self.table_size[1] / 2 + 1e-9:
            raise ValueError("free_edge must lie on the table: what is pushed there would fall off its side")
        if self.turning_edge[0] < self.free_edge[0] or self.turning_edge[1] > self.free_edge[1]:
            raise ValueError("turning_edge must lie in free_edge")
        self._check_bin()
        if (np.array(self.home) < ARM_LOWER).any() or (np.array(self.home) > ARM_UPPER).any():
            raise ValueError("home is beyond the arm's joint limits; the unit is radians")
        if not 0.0 < self.camera_elevation < np.pi / 2:
            raise ValueError("camera_elevation must lie between 0 and pi / 2; the unit is radians")
        if max(self.camera_distance, math.hypot(*(self.camera_position or ()))) > MAX_DISTANCE:
            raise ValueError(f"the camera is over {MAX_DISTANCE:g} m away; the unit is metres")
        if self.optical_frame in (BASE_LINK, CAMERA_LINK):
            raise ValueError(
                f"optical_frame cannot be {self.optical_frame}: its axes are x right, y down, z forward"
            )
        if (self.camera_position is None) != (self.camera_quaternion_xyzw is None):
            raise ValueError("camera_position and camera_quaternion_xyzw go together")
        if self.camera_quaternion_xyzw is not None:
            self._check_camera(self.camera_quaternion_xyzw)

    def _check_bin(self) -> None:
        if self.bin_wall >= min(self.bin_size[0] / 2, self.bin_size[1] / 2, self.bin_size[2]):
            raise ValueError("the bin's walls leave no room: bin_wall, bin_size")
        robot = (0.0, 0.0), (2 * self.pedestal_radius, 2 * self.pedestal_radius)
        for centre, size in ((self.workspace_centre, self.workspace_size), robot):
            apart = np.abs(np.subtract(centre, self.bin_centre)) - np.add(size, self.bin_size[:2]) / 2
            if (apart < -1e-9).all():
                raise ValueError("the bin must stand beside workspace and robot: bin_centre, bin_size")
        lower, upper = self.tcp_bounds
        over_the_bin = np.array([*self.bin_centre, self.table_height + self.bin_size[2]])
        if not ((lower < over_the_bin) & (over_the_bin < upper)).all():
            raise ValueError("the TCP cannot be over the bin's middle: tcp_lower, tcp_upper")

    def _check_camera(self, quaternion: tuple[float, ...]) -> None:
        norm = math.hypot(*quaternion)
        if abs(norm - 1.0) > QUATERNION_TOLERANCE:
            raise ValueError(f"camera_quaternion_xyzw has the norm {norm:.4f}; it must be 1")
        centre = apply(inverse(self.T_base_camera_optical), self.T_base_table[None, :3, 3])[0]
        if centre[2] <= 0.0:
            raise ValueError(
                "the camera looks away from the workspace; its z axis points forward, quaternions are x y z w"
            )

    @property
    def T_base_table(self) -> Array:
        """Frame `table`: origin in the workspace centre on the table top, axes as `base_link`."""
        return transform(position=(*self.workspace_centre, self.table_height))

    @property
    def T_base_camera_optical(self) -> Array:
        """Pose of the depth camera: as measured, or in front of the robot, looking back at the workspace centre."""
        if self.camera_position is not None and self.camera_quaternion_xyzw is not None:
            return from_quaternion(self.camera_position, self.camera_quaternion_xyzw)
        centre = self.T_base_table[:3, 3]
        direction = np.array([np.cos(self.camera_elevation), 0.0, np.sin(self.camera_elevation)])
        return look_at(centre + self.camera_distance * direction, centre)

    @property
    def T_base_camera_link(self) -> Array:
        """(4, 4) pose of `camera_link` (x forward, y left, z up), from which realsense-ros hangs all its frames."""
        return self.T_base_camera_optical @ inverse(T_CAMERA_LINK_OPTICAL)

    @property
    def table_edge(self) -> float:
        """x of the table's edge beside the robot, in `base_link` [m]."""
        return self.table_centre[0] - self.table_size[0] / 2

    @property
    def tcp_bounds(self) -> tuple[Array, Array]:
        """Lower and upper corner (3,) of the box that the TCP stays in [m]."""
        return np.array([*self.tcp_lower, self.table_height - _BELOW]), np.array(self.tcp_upper)

    @property
    def workspace_bounds(self) -> tuple[Array, Array]:
        """Lower and upper corner (3,) of the workspace box in `base_link` [m]."""
        centre, half = np.array(self.workspace_centre), np.array(self.workspace_size) / 2
        return (
            np.array([*(centre - half), self.table_height - _BELOW]),
            np.array([*(centre + half), self.table_height + self.workspace_height]),
        )

    @property
    def cloud_bounds(self) -> tuple[Array, Array]:
        """The same of the box that clouds are cut to: beyond the table's edge, and as far as things reach out [m]."""
        low, high = self.workspace_bounds
        return np.array([self.table_edge - OVERHANG, low[1] - BEYOND, low[2]]), high + (BEYOND, BEYOND, 0.0)


def load_cell(path: Path | str) -> Cell:
    """The cell of a YAML file that holds fields of `Cell`; what it does not name has its default.

    Raises:
        DgsError: DESCRIPTION_MISSING, there is no such file; PARAMETER_INVALID, with the path and what is wrong.
    """
    return _cell(Path(path), _read(Path(path)))


def _cell(path: Path, content: dict[Any, Any]) -> Cell:
    defaults = vars(Cell()) | {"camera_position": (0.0,) * 3, "camera_quaternion_xyzw": (0.0,) * 4}
    values = {}
    for name, value in content.items():
        if name not in defaults:
            raise _refuse(path, f"has the unknown entry {name!r}; there are {', '.join(defaults)}")
        values[name] = _value(path, name, value, defaults[name])
    try:
        return Cell(**values)
    except ValueError as error:
        raise _refuse(path, f"cannot be: {error}") from error


def save_camera(path: Path, T_base_camera_optical: Array) -> None:
    """Write a measured pose (4, 4) of the optical frame into a cell's file; its other lines stay.

    Raises:
        DgsError: PARAMETER_INVALID, there is such a file, but it is not a cell's, or it cannot be written.
    """
    content = _read(path) if path.exists() else {}
    position, quaternion = to_quaternion(T_base_camera_optical)
    camera = {
        "camera_position": position.round(9).tolist(),
        "camera_quaternion_xyzw": quaternion.round(12).tolist(),
    }
    merged = content | camera
    _cell(path, merged)
    kept = _without(path.read_text(encoding="utf-8"), camera) if path.exists() else ""
    text = kept + _dumped(camera)
    try:
        as_meant = load_yaml(text) == merged
    except yaml.YAMLError:  # all on one line, say, or with a mark at its end
        as_meant = False
    try:
        with atomic_write(path, "w") as file:
            file.write(text if as_meant else _dumped(merged))
    except OSError as error:
        raise _refuse(path, f"cannot be written: {error}") from error


def _dumped(content: dict[Any, Any]) -> str:
    return yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=140)


def _without(text: str, names: Collection[str]) -> str:
    """The lines of a YAML mapping, comments too, without those of some entries."""
    mapping, lines = yaml.compose(text), text.splitlines()
    for name, value in [] if mapping is None else mapping.value[::-1]:
        if name.value in names:
            listed = isinstance(value, yaml.SequenceNode) and not value.flow_style
            last = (value.value[-1] if listed else value).end_mark  # that of a list lies behind comments
            del lines[name.start_mark.line : last.line + (last.column > 0)]
    return "".join(f"{line}\n" for line in lines)


def _read(path: Path) -> dict[Any, Any]:
    try:
        content = load_yaml(path.read_text(encoding="utf-8"))
    except (FileNotFoundError, NotADirectoryError) as error:
        missing = f"no cell at {path}: name its file in {CHOICE}, or unset it"
        raise DgsError(ErrorCode.DESCRIPTION_MISSING, missing) from error
    except (OSError, ValueError, OverflowError, yaml.YAMLError) as error:
        raise _refuse(path, f"cannot be read: {error}") from error
    if content is None:
        return {}
    if not isinstance(content, dict):
        raise _refuse(path, "must hold entries of the cell, name: value")
    return content


def _value(path: Path, name: str, value: object, default: Any) -> Any:
    """The value, if it has the form of the default."""
    if isinstance(default, str):
        if isinstance(value, str) and value.strip("/ "):
            return value.strip("/ ")
        raise _refuse(path, f"has {name}: {value!r}; it must be a name")
    count = np.shape(default)
    try:
        numbers = np.array(value, float)
    except (TypeError, ValueError, OverflowError):
        numbers = np.array(np.nan)
    said = np.array(value, object).ravel().tolist() if np.shape(numbers) == count else []
    if (
        numbers.shape != count
        or any(isinstance(each, bool) for each in said)
        or not np.isfinite(numbers).all()
    ):
        wanted = f"{count[0]} finite numbers" if count else "a finite number"
        raise _refuse(path, f"has {name}: {value!r}; it must be {wanted}")
    return tuple(numbers.tolist()) if count else float(numbers)


def _refuse(path: Path, what: str) -> DgsError:
    return DgsError(ErrorCode.PARAMETER_INVALID, f"the cell {path} {what}")


try:
    CELL = load_cell(os.environ[CHOICE]) if os.environ.get(CHOICE) else Cell()
except DgsError as error:  # here for all programs: none of them gets past this import
    print(f"{CHOICE}: {error.message} (code {int(error.code)})", file=sys.stderr)
    raise SystemExit(2) from None

HOME_ARM = np.array(CELL.home)
"""`CELL.home`, (6,) [rad]."""
