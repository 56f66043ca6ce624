"""sensor_msgs/Image and CameraInfo <-> numpy: depth as realsense-ros publishes it, colour, pinhole intrinsics."""

from __future__ import annotations

from array import array

import numpy as np
from builtin_interfaces.msg import Time
from numpy.typing import NDArray
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header

from dgs_description.camera import MILLIMETRE, PinholeCamera
from dgs_description.errors import DgsError, ErrorCode

_DEPTH = {"16UC1": "u2", "mono16": "u2", "32FC1": "f4"}
_COLOUR = {"rgb8": (3, (0, 1, 2)), "bgr8": (3, (2, 1, 0)), "rgba8": (4, (0, 1, 2)), "bgra8": (4, (2, 1, 0))}
_WRITTEN = {("u2", 2): "16UC1", ("f4", 2): "32FC1", ("u1", 2): "mono8", ("u1", 3, 3): "rgb8"}
"""Encoding by type of the numbers, dimensions, channels."""


def depth_to_numpy(msg: Image) -> NDArray[np.uint16] | NDArray[np.float32]:
    """A depth image as it was published, without a copy.

    Returns:
        (H, W) uint16 [mm] of encoding 16UC1, 0 = no measurement; or float32 [m] of 32FC1, NaN = no measurement.

    Raises:
        DgsError: DEPTH_FORMAT for another encoding or sizes that do not fit the data.
    """
    if msg.encoding not in _DEPTH:
        raise _refuse(f"encoding {msg.encoding!r} is none of {', '.join(_DEPTH)}")
    return _pixels(msg, np.dtype((">" if msg.is_bigendian else "<") + _DEPTH[msg.encoding]), 1)[..., 0]


def depth_to_metres(msg: Image) -> NDArray[np.float32]:
    """(H, W) depth [m], 0 = no measurement. Raises as `depth_to_numpy`."""
    depth = depth_to_numpy(msg)
    if depth.dtype.kind == "u":
        return depth.astype(np.float32) * np.float32(MILLIMETRE)
    return np.where(np.isfinite(depth), depth, 0).astype(np.float32)


def infrared_to_numpy(msg: Image) -> NDArray[np.uint8]:
    """(H, W) uint8 of a mono8 image. Raises DgsError DEPTH_FORMAT for another encoding or size."""
    if msg.encoding not in ("mono8", "8UC1"):
        raise _refuse(f"encoding {msg.encoding!r} of an infrared image is neither mono8 nor 8UC1")
    return np.ascontiguousarray(_pixels(msg, np.dtype("u1"), 1)[..., 0])


def colour_to_numpy(msg: Image) -> NDArray[np.uint8]:
    """(H, W, 3) uint8 red green blue of an rgb8, bgr8, rgba8, bgra8 or mono8 image. Raises DgsError DEPTH_FORMAT."""
    if msg.encoding == "mono8":
        return np.repeat(_pixels(msg, np.dtype("u1"), 1), 3, axis=2)
    if msg.encoding not in _COLOUR:
        raise _refuse(f"encoding {msg.encoding!r} is none of {', '.join(_COLOUR)}, mono8")
    channels, order = _COLOUR[msg.encoding]
    return np.ascontiguousarray(_pixels(msg, np.dtype("u1"), channels)[..., order])


def numpy_to_image(pixels: NDArray, frame_id: str, stamp: Time | None = None) -> Image:
    """16UC1 of (H, W) uint16 [mm], 32FC1 of (H, W) float [m], mono8 of (H, W) uint8, rgb8 of (H, W, 3) uint8.

    Raises:
        DgsError: DEPTH_FORMAT for another shape or type.
    """
    kind = "f4" if pixels.dtype.kind == "f" else pixels.dtype.str[1:]
    encoding = _WRITTEN.get((kind, pixels.ndim, *pixels.shape[2:]))
    if encoding is None:
        raise _refuse(f"there is no encoding for {pixels.shape} of {pixels.dtype}")
    packed = np.ascontiguousarray(pixels, dtype=f"<{kind}")
    data = array("B")
    data.frombytes(packed.reshape(-1).view(np.uint8).data)
    (height, width), header = packed.shape[:2], _header(frame_id, stamp)
    step = packed.nbytes // height
    return Image(header=header, height=height, width=width, encoding=encoding, step=step, data=data)


def camera_info_to_pinhole(msg: CameraInfo) -> PinholeCamera:
    """Camera of the rectified image: of P, or of K where P is empty. Raises DgsError CAMERA_INFO_INVALID."""
    fx, fy, cx, cy = msg.p[0], msg.p[5], msg.p[2], msg.p[6]
    if not any(msg.p):
        fx, fy, cx, cy = msg.k[0], msg.k[4], msg.k[2], msg.k[5]
    return PinholeCamera(int(msg.width), int(msg.height), float(fx), float(fy), float(cx), float(cy))


def camera_info_to_baseline(msg: CameraInfo) -> float:
    """Distance of the right imager from the left one [m], from its P = K [I | -b e_x] (sensor_msgs/CameraInfo).

    Raises:
        DgsError: CAMERA_INFO_INVALID: it says none.
    """
    baseline = -msg.p[3] / msg.p[0] if msg.p[0] > 0 else 0.0
    if not 1e-3 < baseline < 10.0:
        says = f"P[3] {msg.p[3]}, P[0] {msg.p[0]}"
        need = "P[3] must be minus focal length times baseline"
        raise DgsError(
            ErrorCode.CAMERA_INFO_INVALID, f"the right imager's camera info has no baseline: {says}; {need}"
        )
    return float(baseline)


def pinhole_to_camera_info(
    camera: PinholeCamera, frame_id: str, stamp: Time | None = None, baseline: float = 0.0
) -> CameraInfo:
    """Camera info of a rectified, distortion-free image, as realsense-ros publishes it.

    Args:
        baseline: of a right imager, its distance from the left one [m].
    """
    fx, fy, cx, cy = camera.fx, camera.fy, camera.cx, camera.cy
    return CameraInfo(
        header=_header(frame_id, stamp),
        width=camera.width,
        height=camera.height,
        distortion_model="plumb_bob",
        d=[0.0] * 5,
        k=[fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
        r=[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        p=[fx, 0.0, cx, -fx * baseline, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
    )


def _pixels(msg: Image, kind: np.dtype, channels: int) -> NDArray:
    """(H, W, channels) view on the message's data."""
    row = msg.width * channels * kind.itemsize
    if msg.height * msg.width == 0:
        raise _refuse(f"the image has {msg.width} x {msg.height} pixels")
    if msg.step < row:
        raise _refuse(f"step {msg.step} is less than the {row} bytes of a row")
    if len(msg.data) != msg.step * msg.height:
        came = f"{len(msg.data)} bytes of data came"
        raise _refuse(f"{came} instead of height {msg.height} times step {msg.step}")
    strides = (msg.step, channels * kind.itemsize, kind.itemsize)
    return np.ndarray((msg.height, msg.width, channels), kind, memoryview(msg.data), strides=strides)


def _header(frame_id: str, stamp: Time | None) -> Header:
    return Header(frame_id=frame_id, stamp=Time() if stamp is None else stamp)


def _refuse(what: str) -> DgsError:
    return DgsError(ErrorCode.DEPTH_FORMAT, f"the image cannot be used: {what}")
