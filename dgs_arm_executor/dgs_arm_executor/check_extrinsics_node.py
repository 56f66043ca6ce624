"""`ros2 run dgs_arm_executor check_extrinsics`: does the observed table lie where the camera's pose puts it?

Prints tilt and height error. Exit code 0: within the bounds; 1: off, or no table seen (code 221); 2: no usable cloud.
"""

from __future__ import annotations

import sys
import threading
from dataclasses import dataclass
from typing import Any, NoReturn

import numpy as np
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import PointCloud2

from dgs_arm_executor.table_check import TableBounds, fit_table
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import BASE_LINK
from dgs_ros.base_node import DgsNode
from dgs_ros.cloud_msgs import cloud_to_numpy
from dgs_ros.parameters import parameter
from dgs_ros.run import EXIT_CLEAN, EXIT_CRASH, EXIT_REFUSED


@dataclass(frozen=True)
class CheckParameters:
    """Which clouds to look at, and what is still right."""

    cloud_topic: str = parameter("/dgs/cloud", "Clouds of the camera node, in base_link.")
    clouds: int = parameter(3, "So many clouds are looked at together.", minimum=1, maximum=100)
    timeout: float = parameter(20.0, "Wait for them [s].", minimum=0.1, maximum=600.0)
    max_tilt: float = parameter(
        TableBounds.tilt, "Largest tilt of the observed table [rad].", minimum=0.001, maximum=0.3
    )
    max_height: float = parameter(
        TableBounds.height, "Largest error of its height [m].", minimum=0.001, maximum=0.1
    )


class CheckNode(DgsNode[CheckParameters]):
    """Collects clouds."""

    def __init__(self, **node_arguments: Any) -> None:
        """Subscribe."""
        super().__init__("check_extrinsics", CheckParameters, **node_arguments)
        self.clouds: list[PointCloud2] = []
        self.create_subscription(
            PointCloud2, self.parameters.cloud_topic, self.clouds.append, qos_profile_sensor_data
        )

    def points(self) -> np.ndarray:
        """(N, 3) of all clouds in `base_link` [m].

        Raises:
            DgsError: CAMERA_SILENT: too few clouds have come; FRAME_UNKNOWN: one is in another frame.
        """
        given = self.parameters
        if len(self.clouds) < given.clouds:
            raise DgsError(
                ErrorCode.CAMERA_SILENT,
                f"{len(self.clouds)} of {given.clouds} clouds came on {given.cloud_topic} within {given.timeout:g} s: "
                "start camera_node",
            )
        for cloud in self.clouds:
            if cloud.header.frame_id != BASE_LINK:
                raise DgsError(
                    ErrorCode.FRAME_UNKNOWN,
                    f"the cloud is in {cloud.header.frame_id!r}, needed is {BASE_LINK!r}",
                )
        return np.concatenate([cloud_to_numpy(cloud) for cloud in self.clouds[: given.clouds]])


def _look() -> int:
    try:
        node = CheckNode()
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        over = threading.Event()
        timer = threading.Timer(node.parameters.timeout, over.set)
        timer.daemon = True
        timer.start()
        while len(node.clouds) < node.parameters.clouds and not over.is_set():
            executor.spin_once(timeout_sec=0.2)
        points = node.points()
    except DgsError as error:
        print(f"cannot check: {error.message} (code {int(error.code)})", file=sys.stderr)
        return EXIT_REFUSED
    try:
        fit = fit_table(points)
        print(fit)
        fit.check(TableBounds(node.parameters.max_tilt, node.parameters.max_height))
    except DgsError as error:
        print(f"extrinsics are off: {error.message} (code {int(error.code)})", file=sys.stderr)
        return EXIT_CRASH
    print("the camera's pose agrees with the table")
    return EXIT_CLEAN


def main(args: list[str] | None = None) -> NoReturn:
    """Check once and end with the exit code."""
    rclpy.init(args=args)
    code = _look()
    rclpy.try_shutdown()
    sys.exit(code)
