"""Loads libusb from its Python package where the system has none: Open3D and pyrealsense2 link against it."""

from __future__ import annotations

import ctypes
import ctypes.util
from functools import cache


@cache
def preload_libusb() -> None:
    """Make `libusb-1.0.so.0` resolvable; call it before `import open3d` or `import pyrealsense2`."""
    if ctypes.util.find_library("usb-1.0"):
        return
    import libusb_package

    path = libusb_package.get_library_path()
    if path is not None:
        ctypes.CDLL(str(path), mode=ctypes.RTLD_GLOBAL)
