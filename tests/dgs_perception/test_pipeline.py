"""Frames of images and clouds on their way to `base_link`."""

from __future__ import annotations

import numpy as np
import pytest

from dgs_description.camera import PinholeCamera
from dgs_description.cell import CELL
from dgs_description.errors import ErrorCode
from dgs_description.frames import CAMERA_LINK, apply, inverse
from dgs_perception.pipeline import CloudPipeline
from tests.support.refused import refused
from tests.support.timing import fastest

PIPELINE = CloudPipeline()
D455 = PinholeCamera(848, 480, 447.0, 446.0, 423.25, 239.5)
CAMERA = PinholeCamera(3, 1, 500.0, 500.0, 1.0, 0.0)


def test_the_centre_pixel_hits_the_workspace_centre():
    """The camera looks at it from `camera_distance`; pixels beside it shift along y, the camera's own x axis."""
    depth = np.full((1, 3), round(CELL.camera_distance * 1000), np.uint16)
    points, counts = PIPELINE.from_depth(depth, CAMERA, "camera_depth_optical_frame")
    centre = CELL.T_base_table[:3, 3]
    offsets = CELL.T_base_camera_optical[:3, 0] * np.array([[-1], [0], [1]]) * CELL.camera_distance / 500
    np.testing.assert_allclose(points, centre + offsets, atol=1e-6)
    assert counts.kept == 3


def test_the_unit_of_the_depth_image_counts():
    depth = np.full((1, 3), round(CELL.camera_distance * 10_000), np.uint16)
    points, _ = PIPELINE.from_depth(depth, CAMERA, "/camera_depth_optical_frame", depth_unit=1e-4)
    np.testing.assert_allclose(points[1], CELL.T_base_table[:3, 3], atol=1e-6)


@pytest.mark.parametrize(
    ("frame", "T_base_frame"),
    [
        ("/base_link", np.eye(4)),
        (CAMERA_LINK, CELL.T_base_camera_link),
        ("camera_depth_optical_frame", CELL.T_base_camera_optical),
    ],
)
def test_clouds_of_every_known_frame_end_in_base_link(frame, T_base_frame):
    rng = np.random.default_rng(5)
    base = rng.uniform(*CELL.workspace_bounds, (1000, 3))
    points, _ = PIPELINE.from_cloud(apply(inverse(T_base_frame), base), frame)
    np.testing.assert_allclose(points, base, atol=1e-6)


@pytest.mark.parametrize("frame", ["", "camera_color_optical_frame", "map"])
def test_other_frames_are_refused(frame):
    for call in (
        lambda: PIPELINE.from_cloud(np.zeros((4, 3)), frame),
        lambda: PIPELINE.from_depth(np.ones((1, 3), np.uint16), CAMERA, frame),
    ):
        with refused(ErrorCode.EXTRINSICS_INVALID, f"in the frame '{frame}'"):
            call()


def test_a_d455_image_is_cropped_fast():
    rng = np.random.default_rng(2)
    depth = rng.integers(800, 1200, (480, 848)).astype(np.uint16)
    depth[rng.random(depth.shape) < 0.1] = 0
    points, counts = PIPELINE.from_depth(depth, D455, "camera_depth_optical_frame")
    assert counts.kept == len(points) > 10_000
    # 35 ms on an idle core whose memory is slow to come, less than 15 ms on others
    assert fastest(lambda: PIPELINE.from_depth(depth, D455, "camera_depth_optical_frame"), 10) < 0.12
