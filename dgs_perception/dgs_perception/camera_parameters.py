"""Parameters of the camera node."""

from __future__ import annotations

from dataclasses import dataclass

from dgs_description.frames import CAMERA_LINK
from dgs_perception.workspace import Workspace, default_lower, default_upper
from dgs_ros.parameters import parameter

REALSENSE, DEPTH_TOPICS, ROSBAG = SOURCES = ("realsense", "depth_topics", "rosbag")


@dataclass(frozen=True)
class CameraParameters:
    """Where depth comes from and what is kept of it; refused with a ValueError when they do not fit together."""

    source: str = parameter(DEPTH_TOPICS, "Where depth comes from.", choices=SOURCES)
    extrinsics_file: str = parameter(
        "", "YAML file of the camera's pose in base_link; empty: the package's own."
    )
    camera_link_frame: str = parameter(CAMERA_LINK, "Name of the frame of the camera's body.")
    publish_optical_frame: bool = parameter(
        True, "Send camera link -> optical frame on /tf_static; switch off where realsense-ros does."
    )
    workspace_lower: tuple[float, float, float] = parameter(
        default_lower(), "Lower corner of the box that is kept, in base_link [m]."
    )
    workspace_upper: tuple[float, float, float] = parameter(
        default_upper(), "Upper corner of the box that is kept, in base_link [m]."
    )
    voxel_size: float = parameter(
        0.0, "Average points in voxels of this edge (needs Open3D); 0 = off [m].", minimum=0.0, maximum=0.1
    )
    silence_timeout: float = parameter(
        2.0, "Without input for so long the camera counts as silent [s].", minimum=0.1, maximum=600.0
    )
    depth_topic: str = parameter(
        "/camera/camera/depth/image_rect_raw", "Depth images for source depth_topics."
    )
    camera_info_topic: str = parameter(
        "/camera/camera/depth/camera_info", "Camera info for source depth_topics."
    )
    realsense_serial: str = parameter(
        "", "Serial number for source realsense; empty: the first camera found."
    )
    realsense_width: int = parameter(848, "Depth image width [px].", minimum=1, maximum=1280)
    realsense_height: int = parameter(480, "Depth image height [px].", minimum=1, maximum=800)
    realsense_rate: int = parameter(30, "Depth images per second [Hz].", minimum=1, maximum=90)
    bag_path: str = parameter("", "Folder or file of the bag for source rosbag.")
    bag_topic: str = parameter("", "Cloud or depth topic in the bag; empty: found by type.")
    bag_info_topic: str = parameter(
        "", "Camera info topic in the bag; empty: the one beside the depth topic."
    )
    bag_rate: float = parameter(1.0, "Factor on the recorded pace.", minimum=0.01, maximum=100.0)
    bag_loop: bool = parameter(True, "Start again at the end of the bag.")
    bag_restamp: bool = parameter(
        False, "Stamp replayed clouds with the present time instead of the recorded one."
    )

    def __post_init__(self) -> None:
        self.workspace()
        if self.source == ROSBAG and not self.bag_path:
            raise ValueError("source 'rosbag' needs the parameter 'bag_path'")
        if not self.camera_link_frame.strip("/ "):
            raise ValueError("the parameter 'camera_link_frame' must name a frame")

    def workspace(self) -> Workspace:
        """The box that is kept."""
        return Workspace(self.workspace_lower, self.workspace_upper, self.voxel_size)
