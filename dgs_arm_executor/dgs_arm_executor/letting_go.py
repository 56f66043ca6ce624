"""Opens the hand over the bin, and frees fingers that something jams or that something hangs on."""

from __future__ import annotations

from dgs_arm_executor.grasp_state import has_let_go
from dgs_arm_executor.robot import Robot, is_hand_fault
from dgs_arm_executor.situation import ArmSituation
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import Array
from dgs_description.grasp import GraspSet
from dgs_description.hand import HAND


def let_go(robot: Robot, grasp: GraspSet) -> tuple[DgsError | None, bool]:
    """Open the hand; what ends that may come before or after the fingers have let go.

    Returns:
        What went wrong, a fault of the hand or whoever interrupted it, and whether the object is free.
    """
    before = robot.situation()
    try:
        trouble = robot.open_hand()
        for shape in (grasp.pre_grasp_joints, grasp.grasp_joints, grasp.pre_grasp_joints, *_swings()):
            if trouble is None or trouble.code is not ErrorCode.HAND_BLOCKED:
                break
            # Something jams a finger: it may fall out while the hand closes and opens, or its fingers swing.
            robot.open_hand(shape)
            trouble = robot.open_hand()
    except DgsError as error:
        trouble = error
    return trouble, trouble is None or _is_free(robot, before, trouble)


def loosen(robot: Robot) -> None:
    """Swing the fingers of an empty hand, so that what hangs on them falls; a fault of the hand ends nothing."""
    for shape in _swings():
        robot.open_hand(shape)


def _is_free(robot: Robot, before: ArmSituation, trouble: DgsError) -> bool:
    """Whether a hand that was ended while it opened holds nothing any more; False if it says nothing."""
    try:
        return has_let_go(before, robot.watch.hand_at_rest(), jammed=is_hand_fault(trouble))
    except DgsError:
        return False


def _swings() -> list[Array]:
    """Hand joints (J,) one after the other that free the fingers: all to one side, the other, bent, and open [rad]."""
    opened, lower, upper = (HAND.split(joints) for joints in (HAND.open_hand, HAND.lower, HAND.upper))
    left, right, bent = opened.copy(), opened.copy(), (opened + upper) / 2
    left[1:, 0], right[1:, 0], bent[:, 0] = lower[1:, 0], upper[1:, 0], opened[:, 0]
    return [shape.reshape(HAND.joint_count) for shape in (left, right, bent, left, right, opened)]
