"""Pictures of one prediction: the cloud with whole hands in it, from the side and through the camera."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from dgs_interfaces.msg import Grasp
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2

from dgs_description.camera import PinholeCamera
from dgs_description.frames import CELL
from dgs_description.grasp import GraspSet
from dgs_description.words import plural
from dgs_ros.cloud_msgs import cloud_to_numpy
from dgs_ros.grasp_msgs import grasps_from_msgs
from dgs_sim_bridge.render.pictures import DrawnHand, View, caption, cloud_colours, draw, palette

MAX_HANDS = 4
MIN_DISTANCE = 0.13
"""Hands in the picture are at least so far apart, so that they can be told apart [m]."""

Picture = NDArray[np.uint8]


def draw_prediction(
    cloud: PointCloud2, image: Picture, camera: PinholeCamera, grasps: Sequence[Grasp]
) -> tuple[Picture, Picture]:
    """Draw the best grasp of every object, or of every place at least.

    Args:
        cloud, grasps: in `base_link`, grasps best first.
        image: (H, W, 3) uint8 of the colour camera, taken from the cell's nominal camera pose.
        camera: that took it.

    Returns:
        View from the side (720, 1280, 3), and the colour image (H, W, 3) with the hands in it.
    """
    T_base_camera = CELL.T_base_camera_optical
    points = cloud_to_numpy(cloud)
    arrays = grasps_from_msgs(grasps)
    chosen = apart(arrays)
    hands = [
        DrawnHand(arrays.pose[k], arrays.grasp_joints[k], colour)
        for k, colour in zip(chosen, palette(len(chosen)), strict=True)
    ]
    side = draw(points, cloud_colours(points, image, camera, T_base_camera), hands, View.oblique())
    note = f"{plural(len(grasps), 'grasp')} predicted, the best {len(hands)} apart from one another"
    nothing = np.empty((0, 3))
    overlay = draw(nothing, nothing, hands, View(camera, T_base_camera), background=image)
    return caption(side, note), caption(overlay, note)


def apart(grasps: GraspSet) -> list[int]:
    """Indices of the best grasps whose TCPs are at least `MIN_DISTANCE` from one another, at most `MAX_HANDS`."""
    chosen: list[int] = []
    for k, position in enumerate(grasps.position):
        others = grasps.position[chosen]
        if len(chosen) < MAX_HANDS and (np.linalg.norm(others - position, axis=1) > MIN_DISTANCE).all():
            chosen.append(k)
    return chosen
