"""`ros2 run dgs_arm_executor check_extrinsics`: does the observed table lie where the camera's pose puts it?

Prints tilt and height error. Exit code 0: within the bounds; 1: off, or no table seen (code 221); 2: no usable cloud.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from typing import NoReturn

import numpy as np
import rclpy
from numpy.typing import NDArray
from rclpy.qos import qos_profile_sensor_data
from rclpy.wait_for_message import wait_for_message
from sensor_msgs.msg import PointCloud2

from dgs_arm_executor.table_check import MAX_HEIGHT, MAX_TILT, fit_table
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import BASE_LINK
from dgs_description.parameters import parameter
from dgs_ros.base_node import DgsNode
from dgs_ros.cloud_msgs import cloud_in
from dgs_ros.run import EXIT_CLEAN, EXIT_CRASH, EXIT_REFUSED, init_ros


@dataclass(frozen=True)
class CheckParameters:
    """Which clouds to look at, and what is still right."""

    cloud_topic: str = parameter("/dgs/cloud", "Clouds of the camera node, in base_link.")
    clouds: int = parameter(3, "So many clouds are looked at together.", 1, 100)
    timeout: float = parameter(20.0, "Wait for them [s].", 0.1, 600.0)
    max_tilt: float = parameter(MAX_TILT, "Largest tilt of the observed table [rad].", 0.001, 0.3)
    max_height: float = parameter(MAX_HEIGHT, "Largest error of its height [m].", 0.001, 0.1)


def _look(node: DgsNode[CheckParameters]) -> NDArray[np.float32]:
    """(N, 3) points of all clouds in `base_link` [m]. Raises DgsError CAMERA_SILENT: too few came; FRAME_UNKNOWN."""
    given, qos = node.parameters, qos_profile_sensor_data
    topic = given.cloud_topic
    clouds: list[PointCloud2] = []
    end = time.monotonic() + given.timeout
    while len(clouds) < given.clouds and rclpy.ok() and (left := end - time.monotonic()) > 0:
        came, cloud = wait_for_message(PointCloud2, node, topic, qos_profile=qos, time_to_wait=left)
        clouds += [cloud] if came else []
    if len(clouds) < given.clouds:
        few = f"{len(clouds)} of {given.clouds} clouds came on {topic} within {given.timeout:g} s"
        raise DgsError(ErrorCode.CAMERA_SILENT, f"{few}: start camera_node")
    return np.concatenate([cloud_in(cloud, BASE_LINK) for cloud in clouds])


def _check(args: list[str] | None) -> int:
    try:
        init_ros(args)
        node = DgsNode("check_extrinsics", CheckParameters)
        points = _look(node)
    except DgsError as error:
        print(f"cannot check: {error.message} (code {int(error.code)})", file=sys.stderr)
        return EXIT_REFUSED
    except KeyboardInterrupt:
        return EXIT_REFUSED
    try:
        fit = fit_table(points)
        print(fit)
        fit.check(node.parameters.max_tilt, node.parameters.max_height)
    except DgsError as error:
        print(f"extrinsics are off: {error.message} (code {int(error.code)})", file=sys.stderr)
        return EXIT_CRASH
    print("the camera's pose agrees with the table")
    return EXIT_CLEAN


def main(args: list[str] | None = None) -> NoReturn:
    """Check once and end with the exit code."""
    code = _check(args)
    rclpy.try_shutdown()
    sys.exit(code)
