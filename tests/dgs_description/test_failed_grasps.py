"""Failed grasps are remembered where their things are, until something is lifted there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dgs_description.failed_grasps import FailedGrasps
from dgs_description.grasp import GraspSet
from dgs_description.hand import HAND


def grasp(x: float, y: float = 0.0, motion: tuple[float, float, float] | None = None) -> GraspSet:
    joints = np.zeros(HAND.joint_count)
    return GraspSet.of(
        "test",
        position=(x, y, 0.05),
        rotation=np.eye(3),
        pre_grasp_joints=joints,
        grasp_joints=joints,
        active_fingers=motion is None,
        motion=motion or 0.0,
    )[0]


def test_a_push_takes_along_what_failed_on_its_thing_and_a_success_forgets_it() -> None:
    failed = FailedGrasps()
    for x in (0.0, 0.04, 0.3):
        failed.note(grasp(x), success=False)
    failed.note(grasp(0.6), success=True)
    np.testing.assert_allclose(failed.poses[:, 0, 3], [0.0, 0.04, 0.3])
    failed.note(grasp(0.02, motion=(-0.2, 0.1, 0.0)), success=False)
    np.testing.assert_allclose(failed.poses[:, 0, 3], [0.0, 0.04, 0.3], err_msg="it may not have moved")
    failed.note(grasp(0.02, motion=(-0.2, 0.1, 0.0)), success=True)
    np.testing.assert_allclose(failed.poses[:, :2, 3], [[-0.2, 0.1], [-0.16, 0.1], [0.3, 0.0]])
    failed.note(grasp(-0.18, 0.1), success=True)
    np.testing.assert_allclose(failed.poses[:, :2, 3], [[0.3, 0.0]])


def test_a_pinch_that_was_moved_to_its_thing_forgets_what_failed_there() -> None:
    failed = FailedGrasps()
    for x in (0.0, 0.2):
        failed.note(grasp(x), success=False)
    pinch = replace(
        grasp(0.15),
        reference_point=np.array([0.03, 0.0, 0.02]),
        active_fingers=np.ones(HAND.finger_count, bool),
        motion=np.array([-0.09, 0.0, 0.0]),
    )
    assert pinch.holds
    failed.note(pinch, success=True)
    np.testing.assert_allclose(failed.poses[:, 0, 3], [0.2])
