"""PointCloud2 <-> numpy: every layout a publisher may choose, and every malformed message."""

from __future__ import annotations

import struct
import time
from array import array
from collections.abc import Callable

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from hypothesis import given, settings
from hypothesis import strategies as st
from sensor_msgs.msg import PointCloud2, PointField

from dgs_description.errors import ErrorCode
from dgs_ros.cloud_msgs import cloud_to_numpy, numpy_to_cloud
from tests.support.refused import refused

FORMATS = {PointField.FLOAT32: "f", PointField.FLOAT64: "d"}


def handmade_cloud(
    points: list[tuple[float, float, float]],
    *,
    width: int | None = None,
    datatype: int = PointField.FLOAT32,
    order: str = "xyz",
    gap: int = 0,
    point_padding: int = 0,
    row_padding: int = 0,
    big_endian: bool = False,
) -> PointCloud2:
    """A cloud packed with `struct`, field by field, with an intensity in front and rubbish in the padding."""
    code = (">" if big_endian else "<") + FORMATS[datatype]
    size = struct.calcsize(code)
    offsets = {axis: 2 + k * (size + gap) for k, axis in enumerate(order)}
    point_step = 2 + 3 * (size + gap) + point_padding
    width = len(points) if width is None else width
    height = len(points) // width if width else 0
    row_step = width * point_step + row_padding
    data = bytearray(b"\xab" * (height * row_step))
    for k, point in enumerate(points):
        start = (k // width) * row_step + (k % width) * point_step
        for axis, value in zip("xyz", point, strict=True):
            struct.pack_into(code, data, start + offsets[axis], value)
    fields = [PointField(name="intensity", offset=0, datatype=PointField.UINT16, count=1)]
    fields += [PointField(name=axis, offset=offsets[axis], datatype=datatype, count=1) for axis in order]
    return PointCloud2(
        height=height,
        width=width,
        fields=fields,
        is_bigendian=big_endian,
        point_step=point_step,
        row_step=row_step,
        data=array("B", bytes(data)),
    )


@settings(max_examples=60, deadline=None)
@given(
    rows=st.integers(1, 4),
    columns=st.integers(1, 5),
    datatype=st.sampled_from(sorted(FORMATS)),
    order=st.permutations("xyz"),
    gap=st.integers(0, 3),
    point_padding=st.integers(0, 5),
    row_padding=st.integers(0, 7),
    big_endian=st.booleans(),
)
def test_any_layout_is_read(rows: int, columns: int, order: list[str], **layout: int) -> None:
    points = [(k + 0.25, -k - 0.5, 100.0 + k) for k in range(rows * columns)]
    msg = handmade_cloud(points, width=columns, order="".join(order), **layout)
    found = cloud_to_numpy(msg)
    assert found.dtype == np.float32
    np.testing.assert_array_equal(found, np.array(points, dtype=np.float32))


def test_there_and_back() -> None:
    points = np.random.default_rng(0).normal(size=(1000, 3)).astype(np.float32)
    msg = numpy_to_cloud(points, "base_link", Time(sec=3, nanosec=4))
    assert (msg.header.frame_id, msg.header.stamp.sec, msg.width, msg.height) == ("base_link", 3, 1000, 1)
    assert (msg.point_step, msg.row_step, msg.is_dense) == (12, 12000, True)
    assert [field.name for field in msg.fields] == ["x", "y", "z"]
    np.testing.assert_array_equal(cloud_to_numpy(msg), points)


@pytest.mark.parametrize(
    "points", [np.eye(3)[:, ::-1], np.eye(3, dtype=int), np.arange(18.0).reshape(3, 6)[:, ::2]]
)
def test_any_array_is_written(points: np.ndarray) -> None:
    np.testing.assert_array_equal(cloud_to_numpy(numpy_to_cloud(points, "a")), points.astype(np.float32))


def test_invalid_points_stay_for_the_caller_to_judge() -> None:
    points = np.array([[1, 2, 3], [np.nan, 0, 0], [np.inf, 1, 1]], dtype=np.float32)
    msg = numpy_to_cloud(points, "a")
    assert not msg.is_dense
    np.testing.assert_array_equal(cloud_to_numpy(msg), points)


def test_doubles_beyond_float_become_infinite_without_a_warning(recwarn: pytest.WarningsRecorder) -> None:
    msg = handmade_cloud([(1e300, 0, 0)], datatype=PointField.FLOAT64)
    assert cloud_to_numpy(msg)[0, 0] == np.inf
    assert not recwarn.list


@pytest.mark.parametrize("msg", [PointCloud2(), numpy_to_cloud(np.empty((0, 3)), "a")])
def test_no_points(msg: PointCloud2) -> None:
    assert cloud_to_numpy(msg).shape == (0, 3)


def _without(name: str) -> Callable[[PointCloud2], None]:
    def change(msg: PointCloud2) -> None:
        msg.fields = [field for field in msg.fields if field.name != name]

    return change


def _set(**values: int) -> Callable[[PointCloud2], None]:
    def change(msg: PointCloud2) -> None:
        for key, value in values.items():
            setattr(msg, key, value)

    return change


def _field(index: int, **values: object) -> Callable[[PointCloud2], None]:
    def change(msg: PointCloud2) -> None:
        for key, value in values.items():
            setattr(msg.fields[index], key, value)

    return change


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (_without("z"), "'z' must be there once; the fields are: x, y"),
        (_field(1, name="x"), "'x' must be there once"),
        (_field(0, datatype=PointField.INT16), "one float32 or float64"),
        (_field(0, count=3), "x 3"),
        (_field(2, offset=9), "beyond point_step 12"),
        (_set(point_step=0, row_step=0), "beyond point_step 0"),
        (_set(point_step=16), "row_step 48 is less than"),
        (_set(point_step=2**32 - 1), "point_step 4294967295 is more"),
        (_set(point_step=2**31 - 1), "row_step 48 is less than"),
        (_set(row_step=60), "48 bytes of data came instead of height 1 times row_step 60"),
        (_set(row_step=4_000_000_000, width=300_000_000), "48 bytes of data"),
        (_set(height=2), "48 bytes of data"),
        (_set(height=0), "48 bytes"),
        (_set(data=array("B", bytes(47))), "47 bytes"),
        (_set(data=array("B")), "0 bytes"),
    ],
)
def test_malformed_clouds_are_refused(change: Callable[[PointCloud2], None], words: str) -> None:
    msg = numpy_to_cloud(np.zeros((4, 3)), "a")
    change(msg)
    with refused(ErrorCode.CLOUD_FORMAT, words):
        cloud_to_numpy(msg)


@pytest.mark.parametrize("points", [np.zeros((3, 4)), np.zeros(3), np.zeros((2, 2, 3))])
def test_arrays_that_are_no_cloud_are_refused(points: np.ndarray) -> None:
    with refused(ErrorCode.CLOUD_FORMAT, "N, 3"):
        numpy_to_cloud(points, "a")


def test_a_full_camera_frame_takes_milliseconds() -> None:
    points = np.random.default_rng(0).normal(size=(848 * 480, 3)).astype(np.float32)
    start = time.perf_counter()
    cloud_to_numpy(numpy_to_cloud(points, "a"))
    # About 10 ms; a loop over the points takes a second and more.
    assert time.perf_counter() - start < 0.3
