"""Image and CameraInfo <-> numpy."""

from __future__ import annotations

from array import array

import numpy as np
import pytest
from sensor_msgs.msg import CameraInfo, Image

from dgs_description.camera import PinholeCamera
from dgs_description.errors import DgsError, ErrorCode
from dgs_ros.image_msgs import (
    camera_info_to_baseline,
    camera_info_to_pinhole,
    colour_to_numpy,
    depth_to_metres,
    depth_to_numpy,
    infrared_to_numpy,
    numpy_to_image,
    pinhole_to_camera_info,
)
from tests.support.refused import refused

D455 = PinholeCamera(848, 480, 447.0, 446.0, 423.5, 239.5)


@pytest.mark.parametrize(
    ("kind", "encoding"), [(np.uint16, "16UC1"), (np.float32, "32FC1"), (np.float64, "32FC1")]
)
def test_depth_there_and_back(kind: type, encoding: str) -> None:
    depth = np.arange(12).reshape(3, 4).astype(kind)
    msg = numpy_to_image(depth, "camera")
    assert (msg.encoding, msg.height, msg.width, msg.header.frame_id) == (encoding, 3, 4, "camera")
    np.testing.assert_array_equal(depth_to_numpy(msg), depth)


def test_padded_rows_and_big_endian_depth() -> None:
    rows = b"".join(row.astype(">u2").tobytes() + b"\xab\xab\xab" for row in np.array([[1, 2], [300, 400]]))
    msg = Image(height=2, width=2, encoding="16UC1", is_bigendian=1, step=7, data=array("B", rows))
    np.testing.assert_array_equal(depth_to_numpy(msg), [[1, 2], [300, 400]])


@pytest.mark.parametrize(
    ("encoding", "pixel"),
    [("rgb8", [1, 2, 3]), ("bgr8", [3, 2, 1]), ("rgba8", [1, 2, 3, 9]), ("bgra8", [3, 2, 1, 9])],
)
def test_colour_comes_as_rgb(encoding: str, pixel: list[int]) -> None:
    data = array("B", bytes(pixel * 6))
    msg = Image(height=2, width=3, encoding=encoding, step=3 * len(pixel), data=data)
    np.testing.assert_array_equal(colour_to_numpy(msg), np.tile([1, 2, 3], (2, 3, 1)))


def test_grey_and_round_trip() -> None:
    grey = Image(height=1, width=2, encoding="mono8", step=2, data=array("B", bytes([7, 8])))
    np.testing.assert_array_equal(colour_to_numpy(grey), [[[7] * 3, [8] * 3]])
    rgb = np.random.default_rng(0).integers(0, 255, (5, 4, 3), dtype=np.uint8)
    np.testing.assert_array_equal(colour_to_numpy(numpy_to_image(rgb[:, ::-1], "c")), rgb[:, ::-1])


@pytest.mark.parametrize(
    "values",
    [
        {"encoding": "8UC1"},
        {"step": 9},
        {"step": 7, "data": array("B", bytes(14))},
        {"height": 3},
        {"height": 0},
        {"width": 0},
        {"data": array("B")},
        {"data": array("B", bytes(15))},
    ],
)
def test_malformed_depth_is_refused(values: dict[str, object]) -> None:
    msg = numpy_to_image(np.zeros((2, 4), np.uint16), "c")
    for key, value in values.items():
        setattr(msg, key, value)
    with refused(ErrorCode.DEPTH_FORMAT):
        depth_to_numpy(msg)


def test_arrays_that_are_no_image_are_refused() -> None:
    shapes = ((2, 2), np.int32), (4, np.uint16), ((2, 2, 4), np.uint8), ((2, 2, 3), np.float32)
    for shape, kind in shapes:
        with refused(ErrorCode.DEPTH_FORMAT, "no encoding for"):
            numpy_to_image(np.zeros(shape, kind), "c")
    with pytest.raises(DgsError, match="encoding 'jpeg'"):
        colour_to_numpy(Image(height=1, width=1, encoding="jpeg"))


def test_infrared_there_and_back() -> None:
    image = np.random.default_rng(0).integers(0, 255, (5, 4), dtype=np.uint8)
    msg = numpy_to_image(image[:, ::-1], "c")
    assert msg.encoding == "mono8"
    np.testing.assert_array_equal(infrared_to_numpy(msg), image[:, ::-1])
    msg.encoding = "rgb8"
    with refused(ErrorCode.DEPTH_FORMAT, "neither mono8"):
        infrared_to_numpy(msg)


def test_depth_in_metres_has_zeros_for_nothing() -> None:
    np.testing.assert_allclose(
        depth_to_metres(numpy_to_image(np.array([[0, 1500]], np.uint16), "c")), [[0, 1.5]]
    )
    floats = np.array([[np.nan, 1.5, np.inf]], np.float32)
    np.testing.assert_array_equal(depth_to_metres(numpy_to_image(floats, "c")), [[0, 1.5, 0]])


def test_the_right_imager_says_its_baseline() -> None:
    msg = pinhole_to_camera_info(D455, "c", baseline=0.095)
    assert camera_info_to_baseline(msg) == pytest.approx(0.095)
    assert camera_info_to_pinhole(msg) == D455, "intrinsics there and back"
    for none in (*(pinhole_to_camera_info(D455, "c", baseline=b) for b in (0.0, 95.0)), CameraInfo()):
        with refused(ErrorCode.CAMERA_INFO_INVALID, "no baseline"):
            camera_info_to_baseline(none)


def test_k_counts_where_p_is_empty() -> None:
    msg = pinhole_to_camera_info(D455, "c")
    msg.p = [0.0] * 12
    assert camera_info_to_pinhole(msg) == D455


def test_a_camera_that_was_not_calibrated_is_refused() -> None:
    with refused(ErrorCode.CAMERA_INFO_INVALID, "image of 0 x 0 pixels"):
        camera_info_to_pinhole(CameraInfo())
    with pytest.raises(DgsError, match="is the camera calibrated"):
        camera_info_to_pinhole(CameraInfo(width=848, height=480))
