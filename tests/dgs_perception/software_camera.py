"""A depth camera made of librealsense's own software device."""

from __future__ import annotations

import numpy as np

from dgs_perception.realsense_source import import_realsense

WIDTH, HEIGHT, RATE = 64, 48, 30


class SoftwareCamera:
    """A software device with one depth stream, and a way to let it take a picture."""

    def __init__(self, focal: float = 60.0, depth_unit: float = 0.001) -> None:
        self.rs = rs = import_realsense()
        self.device = rs.software_device()
        self.device.register_info(rs.camera_info.name, "Software D455")
        self.device.register_info(rs.camera_info.serial_number, "0123")
        self._sensor = self.device.add_sensor("Stereo Module")
        self._sensor.add_read_only_option(rs.option.depth_units, depth_unit)
        self._depth_unit, self._number = depth_unit, 0
        model = rs.intrinsics()
        model.width, model.height, model.fx, model.fy = WIDTH, HEIGHT, focal, focal
        model.ppx, model.ppy = 31.5, 23.5
        model.model, model.coeffs = rs.distortion.none, [0.0] * 5
        stream = rs.video_stream()
        stream.type, stream.index, stream.uid, stream.fmt = rs.stream.depth, 0, 1, rs.format.z16
        stream.width, stream.height, stream.fps, stream.bpp, stream.intrinsics = WIDTH, HEIGHT, RATE, 2, model
        self._profile = self._sensor.add_video_stream(stream).as_video_stream_profile()

    def take(self, depth: np.ndarray, timestamp_ms: float, domain: str = "system_time") -> None:
        frame = self.rs.software_video_frame()
        self._number += 1
        frame.pixels, frame.stride, frame.bpp = depth, 2 * WIDTH, 2
        frame.timestamp, frame.domain = timestamp_ms, getattr(self.rs.timestamp_domain, domain)
        frame.frame_number, frame.profile, frame.depth_units = self._number, self._profile, self._depth_unit
        self._sensor.on_video_frame(frame)
