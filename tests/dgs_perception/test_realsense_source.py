"""The RealSense source on librealsense's own software device: same sensor, profile and queue calls as a D455."""

from __future__ import annotations

import sys
import time
from contextlib import closing

import numpy as np
import pytest

from dgs_description.camera import PinholeCamera
from dgs_description.errors import ErrorCode
from dgs_perception.realsense_source import RealSenseSource, import_realsense
from tests.dgs_perception.software_camera import HEIGHT, RATE, WIDTH, SoftwareCamera
from tests.support.refused import refused


def opened(camera: SoftwareCamera) -> RealSenseSource:
    return RealSenseSource("", (WIDTH, HEIGHT, RATE), camera.device)


def test_a_picture_arrives_with_its_intrinsics_unit_and_stamp():
    camera = SoftwareCamera(depth_unit=0.0005)
    depth = np.arange(HEIGHT * WIDTH, dtype=np.uint16).reshape(HEIGHT, WIDTH)
    with closing(opened(camera)) as source:
        assert source.name == "Software D455 0123"
        camera.take(depth, 1_700_000_000_123.0)
        frame = source.next_frame(2.0)
        assert frame is not None
        np.testing.assert_array_equal(frame.depth, depth)
        assert frame.depth_unit == pytest.approx(0.0005)
        assert frame.camera == PinholeCamera(WIDTH, HEIGHT, 60.0, 60.0, 31.5, 23.5)
        assert frame.stamp_ns == 1_700_000_000_123_000_000
        points = frame.camera.all_points(frame.depth, frame.depth_unit)
        assert points[-1] == pytest.approx([31.5 / 60 * 1.5355, 23.5 / 60 * 1.5355, 1.5355], rel=1e-5)


def test_only_the_newest_picture_is_kept():
    camera = SoftwareCamera()
    with closing(opened(camera)) as source:
        for value in range(1, 6):
            camera.take(np.full((HEIGHT, WIDTH), value, np.uint16), 1000.0 * value)
        last = None
        while (frame := source.next_frame(0.2)) is not None:
            last = frame
        assert last is not None and last.depth[0, 0] == 5


def test_a_clock_that_started_with_the_camera_is_replaced_by_the_computers():
    camera = SoftwareCamera()
    with closing(opened(camera)) as source:
        camera.take(np.ones((HEIGHT, WIDTH), np.uint16), 12.0, domain="hardware_clock")
        frame = source.next_frame(2.0)
        assert frame is not None and abs(frame.stamp_ns - time.time_ns()) < 60 * 10**9


def test_a_silent_camera_gives_none_and_the_stream_restarts():
    camera = SoftwareCamera()
    source = opened(camera)
    assert source.next_frame(0.05) is None
    source.close()
    source.close()
    with closing(opened(camera)) as again:
        camera.take(np.full((HEIGHT, WIDTH), 9, np.uint16), 5.0)
        frame = again.next_frame(2.0)
        assert frame is not None and frame.depth[0, 0] == 9


def test_unusable_intrinsics_are_reported():
    camera = SoftwareCamera(focal=0.0)
    with closing(opened(camera)) as source:
        camera.take(np.ones((HEIGHT, WIDTH), np.uint16), 5.0)
        with refused(ErrorCode.CAMERA_INFO_INVALID):
            source.next_frame(2.0)


def test_a_stream_that_is_not_offered_is_refused_with_what_is():
    with refused(ErrorCode.CAMERA_MISSING, r"no depth stream 848x480x30; it offers 64x48x30"):
        RealSenseSource(device=SoftwareCamera().device)


def test_a_camera_in_use_is_refused():
    camera = SoftwareCamera()
    with closing(opened(camera)), refused(ErrorCode.CAMERA_MISSING, "does not start: .* another program"):
        opened(camera)


def test_a_camera_that_does_not_start_is_not_in_use_afterwards(monkeypatch):
    def too_slow(*_):
        raise RuntimeError("not enough USB bandwidth")

    camera = SoftwareCamera()
    with monkeypatch.context() as patch, refused(ErrorCode.CAMERA_MISSING, "USB bandwidth") as kept:
        patch.setattr(camera.rs.sensor, "start", too_slow)
        opened(camera)
    opened(camera).close()
    assert kept.value.__traceback__  # as the node's health keeps it


def test_a_camera_that_goes_while_it_is_asked_for_its_name_is_missing(monkeypatch):
    def gone(self, device):
        raise RuntimeError("device disconnected")

    monkeypatch.setattr(RealSenseSource, "_describe", gone)
    with refused(ErrorCode.CAMERA_MISSING, "device disconnected"):
        opened(SoftwareCamera())


def test_no_camera_is_said_in_a_sentence():
    serial = "000000000000"  # no camera has it, so this holds on a desk with a camera too
    with refused(ErrorCode.CAMERA_MISSING, f"No RealSense camera with serial number {serial} is connected"):
        RealSenseSource(serial)


def test_a_missing_library_is_said_in_a_sentence(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyrealsense2", None)
    with refused(ErrorCode.CAMERA_MISSING, "install pyrealsense2 and libusb"):
        import_realsense()
