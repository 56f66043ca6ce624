"""Reads a cloud from a file: .ply, .npz, .npy, or a 16-bit depth PNG with the camera's intrinsics."""

from __future__ import annotations

import re
import zipfile
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import trimesh
import yaml
from numpy.typing import NDArray

from dgs_description.arrays import load_arrays
from dgs_description.camera import PinholeCamera
from dgs_description.errors import DgsError, ErrorCode
from dgs_perception.edges import clean_points

_no_cloud = partial(DgsError, ErrorCode.CLOUD_FORMAT)
_no_intrinsics = partial(DgsError, ErrorCode.CAMERA_INFO_INVALID)


@dataclass(frozen=True)
class InputCloud:
    """A cloud as it stands in the file, in the camera's optical frame unless the caller knows better.

    Attributes:
        points: (N, 3) float32 [m], points that are not finite or exactly zero dropped.
        colours: (N, 3) uint8, or None if the file has none.
        received: points in the file.
        masked: (N,) which of the points the mask marks, or None without a mask.
    """

    points: NDArray[np.float32]
    colours: NDArray[np.uint8] | None
    received: int
    masked: NDArray[np.bool_] | None = None


def read_cloud(
    path: Path, intrinsics: str | None = None, mask: Path | None = None, edges: bool = False
) -> InputCloud:
    """Read a cloud.

    Args:
        path: of the file; the suffix says its kind.
        intrinsics: for a depth image: `fx,fy,cx,cy` [px], or a file, see `read_intrinsics`.
        mask: an image that is not black where something may be grasped, one pixel per point of the file.
        edges: sets flying pixels of a depth image right, or takes them out.

    Raises:
        DgsError: CLOUD_FORMAT or DEPTH_FORMAT (unknown, unreadable or wrong contents), CAMERA_INFO_INVALID,
            CLOUD_EMPTY, CLOUD_NOT_FINITE; REQUEST_INVALID (the mask cannot be read, is black, or of another size).
    """
    suffix, colours = path.suffix.lower(), None
    if suffix not in (".ply", ".npz", ".npy", ".png"):
        raise _no_cloud(f"{path} is not one of .ply, .npz, .npy, .png")
    if not path.is_file():
        raise _no_cloud(f"{path} does not exist")
    if intrinsics is not None and suffix != ".png":
        raise _no_intrinsics(f"intrinsics belong to a depth image, {path} is a cloud")
    if suffix == ".png":
        points = _depth_points(path, intrinsics, edges)
    elif suffix == ".ply":
        points, colours = _read_ply(path)
    else:
        points = _read_numpy(path)
    return _checked(path, points, colours, None if mask is None else _read_mask(mask, points.size // 3))


def read_depth(path: Path) -> NDArray[np.uint16]:
    """A depth image (H, W) [mm], 0 = none. Raises DgsError DEPTH_FORMAT."""
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if image is None:
        raise DgsError(ErrorCode.DEPTH_FORMAT, f"{path} is no readable PNG")
    if image.ndim != 2 or image.dtype != np.uint16:
        raise DgsError(
            ErrorCode.DEPTH_FORMAT,
            f"{path} has shape {image.shape} of {image.dtype}; a depth image has one channel of 16 bits [mm]",
        )
    return image


def read_intrinsics(text: str, width: int, height: int) -> PinholeCamera:
    """Camera of an image of `width` x `height` pixels.

    Args:
        text: `fx,fy,cx,cy`, or a JSON or YAML file with the keys fx, fy, cx, cy; with `k` or `K` (row by row, as in
            sensor_msgs/CameraInfo); or with `camera_matrix: {data: [...]}` (as camera calibration writes it); or the
            cam_info.txt of `dgs export`.

    Raises:
        DgsError: CAMERA_INFO_INVALID.
    """
    try:
        numbers = [float(word) for word in text.split(",")]
    except ValueError:
        numbers = _numbers_of_file(Path(text), {"width": width, "height": height})
    if len(numbers) != 4:
        raise _no_intrinsics(f"{text!r} holds {len(numbers)} numbers, fx,fy,cx,cy are needed")
    return PinholeCamera(width, height, *numbers)


def _numbers_of_file(path: Path, size: dict[str, int]) -> list[float]:
    try:
        text = path.read_text(encoding="utf-8")
        values = yaml.safe_load(text)  # JSON is YAML
        if isinstance(values, str):  # a name and a value per line, as `dgs export` writes them
            values = yaml.safe_load(re.sub(r"^(\w+) ", r"\1: ", text, flags=re.MULTILINE))
        for key, wanted in size.items():
            given = values.get(key, values.get(f"image_{key}", wanted))
            if given != wanted:
                raise _no_intrinsics(f"{path} is for {key} {given}, the depth image has {wanted}")
        if "fx" in values:
            return [float(values[key]) for key in ("fx", "fy", "cx", "cy")]
        matrix = values.get("k") or values.get("K") or values["camera_matrix"]["data"]
        fx, _, cx, _, fy, cy, _, _, _ = (float(value) for value in matrix)
        return [fx, fy, cx, cy]
    except (OSError, yaml.YAMLError, AttributeError, KeyError, TypeError, ValueError) as error:
        lacking = f"{path} cannot be read, or lacks fx, fy, cx, cy, or k, or camera_matrix"
        raise _no_intrinsics(lacking) from error


def _depth_points(path: Path, intrinsics: str | None, edges: bool) -> NDArray[np.float32]:
    if intrinsics is None:
        raise _no_intrinsics("a depth image needs --intrinsics fx,fy,cx,cy or a file")
    image = read_depth(path)
    height, width = image.shape
    camera = read_intrinsics(intrinsics, width, height)
    points = camera.all_points(image)
    if edges:
        clean_points(points, camera)
    return points


def _read_ply(path: Path) -> tuple[NDArray, NDArray[np.uint8] | None]:
    try:
        cloud = trimesh.load(path, process=False)
    except Exception as error:  # a damaged file makes the reader raise all kinds
        raise _no_cloud(f"{path} is no readable PLY file: {error}") from error
    points = np.asarray(getattr(cloud, "vertices", np.empty((0, 3))))
    colours = np.asarray(getattr(cloud, "colors", np.empty((0, 4))))
    fits = colours.shape == (len(points), 4) and len(points) > 0
    return points, colours[:, :3].astype(np.uint8) if fits else None


def _read_numpy(path: Path) -> NDArray:
    try:
        loaded = load_arrays(path) if zipfile.is_zipfile(path) else np.load(path, allow_pickle=False)
        if isinstance(loaded, np.ndarray):
            return loaded
        (name,) = loaded if "points" not in loaded else ["points"]
        return loaded[name]
    except Exception as error:  # numpy's header reader lets errors of Python's own parser through
        raise _no_cloud(f"{path} is no NumPy file of one array or of `points`: {error}") from error


def _read_mask(path: Path, count: int) -> NDArray[np.bool_]:
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if image is None:
        raise DgsError(ErrorCode.REQUEST_INVALID, f"the mask {path} is no readable image")
    marked = (image[..., :3] if image.ndim == 3 else image[..., None]).any(axis=2).ravel()
    if len(marked) != count or not marked.any():
        size = f"{image.shape[1]} x {image.shape[0]} pixels, {int(marked.sum())} of them marked"
        raise DgsError(
            ErrorCode.REQUEST_INVALID,
            f"the mask {path} has {size}: it needs one for each of {count} points, not all black",
        )
    return np.asarray(marked)


def _checked(
    path: Path, points: NDArray, colours: NDArray[np.uint8] | None, marked: NDArray[np.bool_] | None
) -> InputCloud:
    if points.ndim < 2 or points.shape[-1] != 3 or not np.issubdtype(points.dtype, np.number):
        raise _no_cloud(f"{path} holds an array of shape {points.shape} of {points.dtype}, it must be (N, 3)")
    points = points.reshape(-1, 3)
    finite = np.isfinite(points).all(axis=1)
    if len(points) and not finite.any():
        raise DgsError(ErrorCode.CLOUD_NOT_FINITE, f"none of the {len(points)} points of {path} is finite")
    good = finite & (points != 0).any(axis=1)
    if not good.any():
        raise DgsError(ErrorCode.CLOUD_EMPTY, f"{path} has no measured point: it is empty, or all are zero")
    kept = None if colours is None else colours[good]
    masked = None if marked is None else marked[good]
    return InputCloud(points[good].astype(np.float32), kept, len(points), masked)
