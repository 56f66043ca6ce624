"""Pixels to points and back: exact geometry, refused input."""

from __future__ import annotations

import re

import numpy as np
import pytest

from dgs_description.camera import PinholeCamera
from dgs_description.errors import DgsError, ErrorCode
from tests.support.refused import refused

D455 = PinholeCamera(width=848, height=480, fx=447.0, fy=446.0, cx=423.25, cy=239.5)


def pinhole(u: int, v: int, z: float, model: PinholeCamera) -> list[float]:
    return [(u - model.cx) / model.fx * z, (v - model.cy) / model.fy * z, z]


def test_every_pixel_becomes_its_point_in_row_order():
    rng = np.random.default_rng(1)
    depth = rng.integers(300, 3000, (480, 848)).astype(np.uint16)
    points = D455.all_points(depth)
    assert points.shape == (480 * 848, 3) and points.dtype == np.float32
    for u, v in [(0, 0), (847, 0), (0, 479), (847, 479), (424, 240), (17, 333)]:
        np.testing.assert_allclose(
            points[v * 848 + u], pinhole(u, v, depth[v, u] / 1000, D455), rtol=1e-6, atol=1e-7
        )


def test_millimetres_metres_other_units_and_byte_orders_agree():
    depth = np.arange(1, 481 * 848 - 847, dtype=np.uint32).reshape(480, 848).astype(np.uint16)
    from_mm = D455.all_points(depth)
    np.testing.assert_allclose(D455.all_points(depth.astype(np.float32) / 1000), from_mm, rtol=1e-6)
    np.testing.assert_array_equal(D455.all_points(depth.astype(">u2")), from_mm)
    np.testing.assert_allclose(D455.all_points(depth, depth_unit=1e-4), from_mm / 10, rtol=1e-5, atol=1e-9)


def test_deproject_keeps_the_measured_pixels_in_row_order():
    depth = np.array([[0.0, 1.0, np.nan], [np.inf, 2.0, -1.0]], np.float32)
    points = PinholeCamera(3, 2, 100.0, 100.0, 1.0, 0.0).deproject(depth)
    np.testing.assert_allclose(points, [(0.0, 0.0, 1.0), (0.0, 0.02, 2.0)], atol=1e-7)
    assert points.flags.c_contiguous and points.dtype == np.float32


def test_project_is_the_inverse():
    depth = np.random.default_rng(3).uniform(0.4, 2.0, (480, 848)).astype(np.float32)
    pixels = D455.project(D455.deproject(depth))
    v, u = np.divmod(np.arange(480 * 848), 848)
    np.testing.assert_allclose(pixels, np.column_stack([u, v]), atol=1e-3)
    np.testing.assert_allclose(D455.matrix @ (0.1, -0.2, 1.0), [*D455.project([(0.1, -0.2, 1.0)])[0], 1.0])


def test_pixels_without_a_measurement_stay_recognisable():
    model = PinholeCamera(3, 1, 100.0, 100.0, 1.0, 0.0)
    points = model.all_points(np.array([[0.0, np.nan, np.inf]], np.float32))
    assert (points[0] == 0).all()
    assert np.isnan(points[1]).all()
    assert not np.isfinite(points[2]).all()


@pytest.mark.parametrize(
    "image",
    [np.zeros((480, 848), np.uint8), np.zeros((480, 848), np.int32), np.zeros((480, 848, 1), np.uint16)],
    ids=["uint8", "int32", "three dimensions"],
)
def test_another_depth_format_is_refused(image):
    with pytest.raises(DgsError, match="uint16 or floating point") as caught:
        D455.all_points(image)
    assert caught.value.code == ErrorCode.DEPTH_FORMAT == 405


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"fx": 0.0}, "focal lengths fx 0.0"),
        ({"fy": -447.0}, "must be positive"),
        ({"fx": float("nan")}, "must be finite"),
        ({"cx": float("inf")}, "must be finite"),
        ({"cx": -1.0}, "outside its 848 x 480 image"),
        ({"cy": 481.0}, "outside its 848 x 480 image"),
        ({"width": 0}, "an image of 0 x 480 pixels"),
    ],
)
def test_impossible_intrinsics_are_refused(change, sentence):
    values = {"width": 848, "height": 480, "fx": 447.0, "fy": 446.0, "cx": 423.0, "cy": 239.0} | change
    with pytest.raises(DgsError, match=re.escape(sentence)) as caught:
        PinholeCamera(**values).all_points(np.ones((480, 848), np.float32))
    assert caught.value.code == ErrorCode.CAMERA_INFO_INVALID == 404


def test_intrinsics_of_another_image_size_are_refused():
    with refused(ErrorCode.CAMERA_INFO_INVALID, "848 x 480 pixels but the depth image 640 x 480"):
        D455.all_points(np.zeros((480, 640), np.uint16))
