"""Reads a cloud from a file: .ply, .npz, .npy, or a 16-bit depth PNG with the camera's intrinsics."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from dgs_description.camera import PinholeCamera
from dgs_description.errors import DgsError, ErrorCode

SUFFIXES = (".ply", ".npz", ".npy", ".png")


@dataclass(frozen=True)
class InputCloud:
    """A cloud as it stands in the file, in the camera's optical frame unless the caller knows better.

    Attributes:
        points: (N, 3) float32 [m], points that are not finite or exactly zero dropped.
        colours: (N, 3) uint8, or None if the file has none.
        received: points in the file.
    """

    points: NDArray[np.float32]
    colours: NDArray[np.uint8] | None
    received: int


def read_cloud(path: Path, intrinsics: str | None = None) -> InputCloud:
    """Read a cloud.

    Args:
        path: of the file; the suffix says its kind.
        intrinsics: for a depth image: `fx,fy,cx,cy` [px], or a file, see `read_intrinsics`.

    Raises:
        DgsError: CLOUD_FORMAT or DEPTH_FORMAT (unknown, unreadable or wrong contents), CAMERA_INFO_INVALID,
            CLOUD_EMPTY, CLOUD_NOT_FINITE.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise _format(f"{path} is not one of {', '.join(SUFFIXES)}")
    if not path.is_file():
        raise _format(f"{path} does not exist")
    if suffix == ".png":
        return _checked(path, _depth_points(path, intrinsics), None)
    if intrinsics is not None:
        raise DgsError(
            ErrorCode.CAMERA_INFO_INVALID, f"intrinsics belong to a depth image, {path} is a cloud"
        )
    points, colours = _read_ply(path) if suffix == ".ply" else (_read_numpy(path), None)
    return _checked(path, points, colours)


def read_intrinsics(text: str, width: int, height: int) -> PinholeCamera:
    """Camera of an image of `width` x `height` pixels.

    Args:
        text: `fx,fy,cx,cy`, or a JSON or YAML file with the keys fx, fy, cx, cy; with `k` or `K` (row by row, as in
            sensor_msgs/CameraInfo); or with `camera_matrix: {data: [...]}` (as camera calibration writes it).

    Raises:
        DgsError: CAMERA_INFO_INVALID.
    """
    try:
        numbers = [float(word) for word in text.split(",")]
    except ValueError:
        numbers = _numbers_of_file(Path(text), width, height)
    if len(numbers) != 4:
        raise _intrinsics(f"{text!r} holds {len(numbers)} numbers, fx,fy,cx,cy are needed")
    return PinholeCamera(width, height, *numbers)


def _numbers_of_file(path: Path, width: int, height: int) -> list[float]:
    try:
        content = path.read_text(encoding="utf-8")
        values = json.loads(content) if path.suffix == ".json" else yaml.safe_load(content)
    except (OSError, ValueError, yaml.YAMLError) as error:
        raise _intrinsics(f"the file {path} cannot be read: {error}") from error
    if not isinstance(values, dict):
        raise _intrinsics(f"the file {path} holds no key-value pairs")
    for key, wanted in (
        ("width", width),
        ("height", height),
        ("image_width", width),
        ("image_height", height),
    ):
        if key in values and values[key] != wanted:
            raise _intrinsics(f"{path} is for {key} {values[key]}, the depth image has {wanted}")
    try:
        if "fx" in values:
            return [float(values[key]) for key in ("fx", "fy", "cx", "cy")]
        return _of_matrix(values)
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise _intrinsics(f"{path} lacks fx, fy, cx, cy, or k, or camera_matrix ({error!r})") from error


def _of_matrix(values: dict[str, Any]) -> list[float]:
    matrix: Sequence[float] = (
        values.get("k") or values.get("K") or (values.get("camera_matrix") or {}).get("data") or []
    )
    if len(matrix) != 9:
        raise ValueError(f"a camera matrix of {len(matrix)} numbers instead of 9")
    return [float(matrix[k]) for k in (0, 4, 2, 5)]


def _depth_points(path: Path, intrinsics: str | None) -> NDArray[np.float32]:
    import cv2

    if intrinsics is None:
        raise _intrinsics("a depth image needs --intrinsics fx,fy,cx,cy or a file")
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if image is None:
        raise DgsError(ErrorCode.DEPTH_FORMAT, f"{path} is no readable PNG")
    if image.ndim != 2 or image.dtype != np.uint16:
        raise DgsError(
            ErrorCode.DEPTH_FORMAT,
            f"{path} has shape {image.shape} of {image.dtype}; a depth image has one channel of 16 bits [mm]",
        )
    height, width = image.shape
    return read_intrinsics(intrinsics, width, height).all_points(image)


def _read_ply(path: Path) -> tuple[NDArray, NDArray[np.uint8] | None]:
    import trimesh

    try:
        cloud = trimesh.load(path, process=False)
    except Exception as error:  # a damaged file makes the reader raise all kinds
        raise _format(f"{path} is no readable PLY file: {error}") from error
    points = np.asarray(getattr(cloud, "vertices", np.empty((0, 3))))
    colours = np.asarray(getattr(cloud, "colors", np.empty((0, 4))))
    fits = colours.shape == (len(points), 4) and len(points) > 0
    return points, colours[:, :3].astype(np.uint8) if fits else None


def _read_numpy(path: Path) -> NDArray:
    try:
        loaded = np.load(path, allow_pickle=False)
    except (OSError, ValueError, EOFError) as error:
        raise _format(f"{path} is no readable NumPy file: {error}") from error
    if isinstance(loaded, np.ndarray):
        return loaded
    with loaded:
        name = "points" if "points" in loaded.files else (loaded.files or [""])[0]
        if name != "points" and len(loaded.files) != 1:
            raise _format(
                f"{path} holds {', '.join(loaded.files) or 'nothing'}; one array or `points` is needed"
            )
        return np.asarray(loaded[name])


def _checked(path: Path, points: NDArray, colours: NDArray[np.uint8] | None) -> InputCloud:
    points = np.asarray(points)
    if points.ndim < 2 or points.shape[-1] != 3 or not np.issubdtype(points.dtype, np.number):
        raise _format(f"{path} holds an array of shape {points.shape} of {points.dtype}, it must be (N, 3)")
    points = points.reshape(-1, 3)
    if len(points) == 0:
        raise DgsError(ErrorCode.CLOUD_EMPTY, f"{path} has no points")
    finite = np.isfinite(points).all(axis=1)
    if not finite.any():
        raise DgsError(ErrorCode.CLOUD_NOT_FINITE, f"none of the {len(points)} points of {path} is finite")
    good = finite & (points != 0).any(axis=1)
    if not good.any():
        raise DgsError(ErrorCode.CLOUD_EMPTY, f"{path} has no measured point, all are zero")
    return InputCloud(
        points[good].astype(np.float32), None if colours is None else colours[good], len(points)
    )


def _format(sentence: str) -> DgsError:
    return DgsError(ErrorCode.CLOUD_FORMAT, sentence)


def _intrinsics(sentence: str) -> DgsError:
    return DgsError(ErrorCode.CAMERA_INFO_INVALID, sentence)
