"""Calm where things stand, at once where they move."""

from __future__ import annotations

import numpy as np

from dgs_description.camera import PinholeCamera
from dgs_description.cell import Cell
from dgs_perception.frames_median import FramesMedian
from dgs_perception.pipeline import CloudPipeline
from dgs_sim_bridge.render.d455 import D455Noise


def test_the_noise_of_a_standing_surface_goes_down() -> None:
    camera = PinholeCamera(212, 120, 424.0, 424.0, 106.0, 60.0)
    ideal, rng = np.full((120, 212), 0.9, np.float32), np.random.default_rng(0)
    noise = D455Noise(bias_rms=0.0, shadows=False)
    median = FramesMedian(7)
    frames = [noise.apply(ideal, camera, rng) for _ in range(7)]
    calm = [median(frame) for frame in frames][-1]
    one, many = (np.std(image[image > 0] - 0.9) for image in (frames[-1], calm))
    assert many < 0.55 * one and abs(np.median(calm) - 0.9) < 0.001


def test_what_moves_is_seen_where_it_is_now() -> None:
    median, far = FramesMedian(5), np.ones((1, 1), np.float32)
    for column in range(10):
        frame = np.full((4, 12), 1.0, np.float32)
        frame[:, column] = 0.8
        np.testing.assert_array_equal(median(frame), frame)
    assert [median(depth * far)[0, 0] for depth in (2.0, 2.0, 2.03)] == [2.0, 2.0, 2.0], "noise, there"


def test_what_flickers_is_filled_and_holes_stay() -> None:
    median = FramesMedian(4)
    for k in range(5):
        frame = np.full((2, 3), 1.0, np.float32)
        frame[0, 0] = 0.0 if k == 4 else 1.0
        frame[0, 1] = 0.0 if k in (2, 4) else 1.0
        frame[1, 1] = 1.0 if k == 2 else np.nan
        calm = median(frame)
    np.testing.assert_array_equal(calm, [[1, 0, 1], [1, 0, 1]])


def test_what_has_left_a_hole_behind_stays_for_half_of_the_frames() -> None:
    median = FramesMedian(7)
    for _ in range(7):
        median(np.full((1, 1), 0.5, np.float32))
    assert [median(np.zeros((1, 1), np.float32))[0, 0] for _ in range(5)] == [0.5, 0.5, 0.5, 0.0, 0.0]


def test_another_image_size_begins_anew() -> None:
    median = FramesMedian(5)
    median(np.full((2, 3), 1.0, np.float32))
    np.testing.assert_array_equal(median(np.full((3, 3), 2.0, np.float32)), np.full((3, 3), 2.0))


def test_the_pipeline_calms_depth_images() -> None:
    camera = PinholeCamera(212, 120, 424.0, 424.0, 106.0, 60.0)
    cell = Cell(
        table_size=(10.0, 10.0, 0.04),
        workspace_size=(9.0, 9.0),
        workspace_height=9.0,
        bin_centre=(-5.0, 0.0),
        tcp_lower=(-6.0, -1.0),
        camera_position=(0.3, 0.0, -0.8),
        camera_quaternion_xyzw=(0.0, 0.0, 0.0, 1.0),
        optical_frame="eye",
    )
    pipelines = [CloudPipeline(cell, median=median) for median in (None, FramesMedian(7))]
    rng = np.random.default_rng(0)
    spread = []
    for _ in range(7):
        depth = (1000 + 3 * rng.standard_normal((120, 212))).astype(np.uint16)
        spread = [np.std(pipeline.from_depth(depth, camera, "eye")[0][:, 2]) for pipeline in pipelines]
    assert spread[1] < 0.6 * spread[0]
