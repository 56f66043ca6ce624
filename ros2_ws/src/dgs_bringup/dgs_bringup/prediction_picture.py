"""Pictures of one prediction: the cloud with whole hands in it, from the side and through the camera."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from dgs_interfaces.msg import Grasp
from sensor_msgs.msg import PointCloud2

from dgs_description.camera import PinholeCamera
from dgs_description.cell import CELL
from dgs_description.words import plural
from dgs_ros.cloud_msgs import cloud_to_numpy
from dgs_ros.grasp_msgs import grasps_from_msgs
from dgs_sim_bridge.render.pictures import DrawnHand, Picture, View, caption, cloud_colours, draw, palette

MAX_HANDS = 4
MIN_DISTANCE = 0.13
"""Hands in the picture are at least so far apart, so that they can be told apart [m]."""


def draw_prediction(
    cloud: PointCloud2, image: Picture, camera: PinholeCamera, grasps: Sequence[Grasp]
) -> tuple[Picture, Picture]:
    """Draw the best grasp of every object, or of every place at least.

    Args:
        cloud, grasps: in `base_link`, grasps best first.
        image: (H, W, 3) uint8 of the colour camera, taken from the cell's nominal camera pose.

    Returns:
        View from the side (720, 1280, 3), and the colour image (H, W, 3) with the hands in it.
    """
    T_base_camera = CELL.T_base_camera_optical
    points = cloud_to_numpy(cloud)
    chosen = grasps_from_msgs(grasps).apart(MIN_DISTANCE, MAX_HANDS)
    shown = zip(chosen.pose, chosen.grasp_joints, palette(len(chosen)), strict=True)
    hands = [DrawnHand(*hand) for hand in shown]
    side = draw(points, cloud_colours(points, image, camera, T_base_camera), hands, View.oblique())
    note = f"{plural(len(grasps), 'grasp')} predicted, the best {len(hands)} apart from one another"
    nothing = np.empty((0, 3))
    overlay = draw(nothing, nothing, hands, View(camera, T_base_camera), background=image)
    return caption(side, note), caption(overlay, note)
