"""visualization_msgs/MarkerArray of predicted hands: finger bones, fingertips, approach, coloured by score."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from geometry_msgs.msg import Point, Vector3
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from dgs_description.frames import Array, inverse
from dgs_description.grasp import GraspSet
from dgs_description.hand import HAND
from dgs_description.hand_model import JOINTS_PER_FINGER
from dgs_description.pick import STAND_OFF
from dgs_grasp_planner.contact.closing import posed


def _segments(grasps: GraspSet) -> Array:
    """(K, S, 2, 3) line segments of every hand, in the grasps' frame [m]."""
    count = len(grasps)
    own = np.zeros((HAND.finger_count, 1, 3))
    links = [HAND.finger_points(grasps.grasp_joints, link, own) for link in range(1, JOINTS_PER_FINGER)]
    joints = np.concatenate([*links, HAND.fingertips(grasps.grasp_joints)[:, :, None]], axis=2)
    wrist = np.broadcast_to(inverse(HAND.T_base_tcp)[:3, 3], (count, HAND.finger_count, 1, 3))
    knuckles = np.broadcast_to(HAND.base_poses[:, None, :3, 3], (count, HAND.finger_count, 1, 3))
    chain = np.concatenate([wrist, knuckles, joints], axis=2)
    fingers = np.stack([chain[:, :, :-1], chain[:, :, 1:]], axis=3).reshape(count, -1, 2, 3)
    approach = np.broadcast_to(np.array([[[0.0, 0.0, -STAND_OFF], [0.0, 0.0, 0.0]]]), (count, 1, 2, 3))
    return posed(np.concatenate([fingers, approach], axis=1), grasps.position, grasps.rotation)


def _colours(score: Array, each: int) -> list[ColorRGBA]:
    """Red (0) over yellow to green (1), repeated `each` times per grasp."""
    out = []
    for value in score:
        colour = ColorRGBA(r=float(min(1.0, 2 - 2 * value)), g=float(min(1.0, 2 * value)), b=0.1, a=0.9)
        out += [colour] * each
    return out


def _list(
    header: Header, number: int, name: str, kind: int, width: float, points: Array, colours: Iterable
) -> Marker:
    marker = Marker(header=header, ns=name, id=number, type=kind, action=Marker.ADD)
    marker.scale = Vector3(x=width, y=width, z=width)
    marker.points = [Point(x=x, y=y, z=z) for x, y, z in points.reshape(-1, 3).tolist()]
    marker.colors = list(colours)
    return marker


def grasps_to_markers(grasps: GraspSet, header: Header) -> MarkerArray:
    """Markers that replace all earlier ones; with no grasps the view is cleared."""
    clear = Marker(header=header, action=Marker.DELETEALL)
    if len(grasps) == 0:
        return MarkerArray(markers=[clear])
    segments = _segments(grasps)
    tips = posed(HAND.fingertips(grasps.grasp_joints), grasps.position, grasps.rotation)
    hands = _list(
        header, 0, "hands", Marker.LINE_LIST, 0.003, segments, _colours(grasps.score, 2 * segments.shape[1])
    )
    dots = _list(
        header, 1, "fingertips", Marker.SPHERE_LIST, 0.012, tips, _colours(grasps.score, HAND.finger_count)
    )
    white = [ColorRGBA(r=1.0, g=1.0, b=1.0, a=1.0)] * len(grasps)
    reference = _list(header, 2, "reference_points", Marker.SPHERE_LIST, 0.008, grasps.reference_point, white)
    return MarkerArray(markers=[clear, hands, dots, reference])
