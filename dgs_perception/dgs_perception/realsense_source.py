"""Depth images straight from a RealSense camera through pyrealsense2, without realsense-ros."""

from __future__ import annotations

import time
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dgs_description.camera import PinholeCamera
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.native import preload_libusb

Mode = tuple[int, int, int]
"""Width, height [px] and images per second [Hz] of a depth stream."""
D455_MODE: Mode = (848, 480, 30)
"""What the maker recommends for the D455."""


@dataclass(frozen=True, eq=False)
class DepthFrame:
    """One depth image.

    Attributes:
        depth: (H, W) uint16 in `depth_unit`; 0 where nothing was measured.
        depth_unit: size of one step [m].
        camera: that took it.
        stamp_ns: when it was taken, in the computer's clock since 1970 [ns].
    """

    depth: NDArray[np.uint16]
    depth_unit: float
    camera: PinholeCamera
    stamp_ns: int


def import_realsense() -> ModuleType:
    """The module pyrealsense2. Raises DgsError CAMERA_MISSING, with what to install."""
    try:
        preload_libusb()
        import pyrealsense2
    except (ImportError, OSError) as error:
        how = "pip: libusb-package importlib_resources, or apt: libusb-1.0-0"
        why = f"pyrealsense2 cannot be loaded ({error}); install pyrealsense2 and libusb ({how})."
        raise DgsError(ErrorCode.CAMERA_MISSING, why) from error
    return pyrealsense2


class RealSenseSource:
    """The running depth stream of one camera, with a `name` for messages to people."""

    def __init__(self, serial: str = "", mode: Mode = D455_MODE, device: Any = None) -> None:
        """Find the camera and start its depth stream.

        Args:
            serial: number as printed on the camera; empty takes the first one found.
            device: an `rs.device` to use instead of searching, e.g. an `rs.software_device`.

        Raises:
            DgsError: CAMERA_MISSING when there is no such camera, it does not offer the wanted stream, or another
                program has it.
        """
        self._rs = import_realsense()
        self.name = serial
        try:
            device = device if device is not None else self._find_device(serial)
            self.name = self._describe(device)
            self._sensor = device.first_depth_sensor()
            profile = self._find_profile(mode)
            computer_clock = self._rs.option.global_time_enabled
            if self._sensor.supports(computer_clock):
                self._sensor.set_option(computer_clock, 1)
            self._queue = self._rs.frame_queue(1)  # only the newest image counts
            self._sensor.open(profile)
            try:
                self._sensor.start(self._queue)
            except RuntimeError:
                self._sensor.close()  # or the next try would find it in use
                raise
        except RuntimeError as error:
            idle = f"The camera {self.name} does not start: {error} (does another program use it?)"
            raise DgsError(ErrorCode.CAMERA_MISSING, idle) from error
        self._running = True

    def _find_device(self, wanted: str) -> Any:
        devices = list(self._rs.context().query_devices())
        for device in devices:
            if not wanted or device.get_info(self._rs.camera_info.serial_number) == wanted:
                return device
        which = f"RealSense camera with serial number {wanted}" if wanted else "RealSense camera"
        found = ", ".join(self._describe(device) for device in devices) or "none"
        missing = f"No {which} is connected (found: {found}); check the USB 3 cable and the udev rules."
        raise DgsError(ErrorCode.CAMERA_MISSING, missing)

    def _describe(self, device: Any) -> str:
        infos = (self._rs.camera_info.name, self._rs.camera_info.serial_number)
        return " ".join(device.get_info(info) for info in infos if device.supports(info)) or "without a name"

    def _find_profile(self, wanted: Mode) -> Any:
        offered = []
        for profile in self._sensor.get_stream_profiles():
            if profile.stream_type() != self._rs.stream.depth or profile.format() != self._rs.format.z16:
                continue
            video = profile.as_video_stream_profile()
            mode = video.width(), video.height(), profile.fps()
            if mode == wanted:
                return profile
            offered.append("{}x{}x{}".format(*mode))
        missing = f"The camera {self.name} has no depth stream {'{}x{}x{}'.format(*wanted)}"
        others = f"it offers {', '.join(offered) or 'none'} (a USB 2 cable offers fewer)."
        raise DgsError(ErrorCode.CAMERA_MISSING, f"{missing}; {others}")

    def next_frame(self, timeout: float) -> DepthFrame | None:
        """The newest image, None if none comes within `timeout` [s]. Raises DgsError CAMERA_INFO_INVALID."""
        arrived, frame = self._queue.try_wait_for_frame(round(timeout * 1e3))
        if not arrived:
            return None
        depth = frame.as_depth_frame()
        model = depth.profile.as_video_stream_profile().intrinsics
        camera = PinholeCamera(model.width, model.height, model.fx, model.fy, model.ppx, model.ppy)
        # The copy gives the frame back to the camera's small pool at once.
        return DepthFrame(np.array(depth.get_data()), depth.get_units(), camera, self._stamp(depth))

    def _stamp(self, depth: Any) -> int:
        if depth.get_frame_timestamp_domain() == self._rs.timestamp_domain.hardware_clock:
            return time.time_ns()  # a clock that starts with the camera says nothing here
        # A float of milliseconds holds no more than microseconds.
        return round(depth.get_timestamp() * 1e3) * 1000

    def close(self) -> None:
        """Stop the stream; harmless when it is stopped or the camera has been unplugged."""
        if not self._running:
            return
        self._running = False
        try:
            self._sensor.stop()
            self._sensor.close()
        except RuntimeError:
            pass  # unplugged: nothing left to stop
