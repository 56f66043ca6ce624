"""Markers of predicted hands."""

from __future__ import annotations

import numpy as np
from std_msgs.msg import Header
from visualization_msgs.msg import Marker

from dgs_description.grasp import GraspSet
from dgs_description.hand import HAND
from dgs_grasp_planner.marker_msgs import grasps_to_markers
from dgs_grasp_planner.network.decode import grasps_from_outputs


def test_hands_are_drawn_where_they_are() -> None:
    rng = np.random.default_rng(0)
    joints = np.full((3, 15), 0.3)
    grasps = grasps_from_outputs(
        rng.normal(size=(3, 3)),
        np.array([0.1, 0.5, 1.0]),
        rng.normal(size=(3, 6)),
        rng.normal(size=(3, 3)),
        joints,
        joints,
    )
    clear, hands, tips, reference = grasps_to_markers(grasps, Header(frame_id="base_link")).markers
    assert clear.action == Marker.DELETEALL
    assert (
        hands.type == Marker.LINE_LIST
        and len(hands.points) % 2 == 0
        and len(hands.colors) == len(hands.points)
    )
    wanted = (
        np.einsum("kij,kfj->kfi", grasps.rotation, HAND.fingertips(grasps.grasp_joints))
        + grasps.position[:, None]
    )
    np.testing.assert_allclose([(p.x, p.y, p.z) for p in tips.points], wanted.reshape(-1, 3), atol=1e-9)
    np.testing.assert_allclose([(p.x, p.y, p.z) for p in reference.points], grasps.reference_point)
    assert tips.colors[0].g > tips.colors[0].r and tips.colors[-1].r > tips.colors[-1].g, (
        "best is green, worst is red"
    )


def test_no_grasps_clear_the_view() -> None:
    markers = grasps_to_markers(GraspSet.empty(), Header(frame_id="base_link")).markers
    assert [marker.action for marker in markers] == [Marker.DELETEALL]
