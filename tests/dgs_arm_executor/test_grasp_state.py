from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dgs_arm_executor.grasp_state import (
    HoldSettings,
    fingers_held_off,
    grip_lost,
    has_let_go,
    names,
    object_held,
)
from dgs_arm_executor.situation import ArmSituation
from dgs_description.cell import HOME_ARM
from dgs_description.hand import HAND
from tests.support.grasps import top_grasps

FINAL = np.tile([0.0, 0.6, 0.4, 0.4], 5)
GRASP = top_grasps(np.zeros(3), final=FINAL)[0]
MARGIN = np.tile(HAND.grasp.beyond, 5)
APART = HoldSettings(own_contact=-1.0)


def closed(held: list[int], short: float = 0.15) -> np.ndarray:
    joints = HAND.split(FINAL + MARGIN).copy()
    joints[held, 1] -= short
    return joints.ravel()


def test_an_empty_hand_reaches_its_target() -> None:
    assert not object_held(FINAL + MARGIN, GRASP)
    assert not object_held(FINAL + MARGIN - 0.02, GRASP)


def test_fingers_before_their_target_hold_something() -> None:
    held = fingers_held_off(closed([1, 2, 4]), GRASP, APART)
    assert held.tolist() == [False, True, True, False, True]
    assert names(held) == "index, middle, little"
    assert object_held(closed([1, 4]), GRASP, APART)


def test_one_jammed_finger_is_no_object() -> None:
    assert not object_held(closed([4]), GRASP)


def test_fingers_that_do_not_take_part_do_not_count() -> None:
    three = replace(GRASP, active_fingers=np.array([True, True, True, False, False]))
    assert not object_held(closed([3, 4]), three)
    # Whether they take part is said by the grasp: these would change their joints all the same.
    assert HAND.split(np.abs(three.grasp_joints - HAND.pre_grasp(FINAL)))[3:].max() > 0.05


def test_the_thumb_against_a_finger_is_no_object() -> None:
    # Thumb, index and middle finger meet in this posture; all stand far before their targets.
    grasp = replace(GRASP, grasp_joints=np.tile([0.0, 1.2, 0.9, 0.9], 5))
    meeting = np.tile([0.0, 0.6, 0.3, 0.3], 5)
    held = fingers_held_off(meeting, grasp)
    assert fingers_held_off(meeting, grasp, APART).all()
    assert held.tolist() == [False, False, False, True, True]
    assert names(np.zeros(5, dtype=bool)) == "no finger"


CLOSED, OPENED = np.tile([0.0, 0.5, 0.4, 0.4], 5), np.zeros(20)
PRESSING, LIMP, PUSHING_OPEN = np.full(20, 0.3), np.zeros(20), np.full(20, -0.6)
NO_GRIP = np.tile([0.3, 0.0, 0.0, 0.3], 5)
"""Torques of yaw and of the distal joint, which has no drive of its own."""
THUMB_ALONE = np.where(np.arange(20) == 2, 0.3, 0.0)


def left_flexed(*fingers: int) -> np.ndarray:
    joints = np.zeros((5, 4))
    joints[list(fingers)] = CLOSED[:4]
    return joints.ravel()


def hand(joints: np.ndarray, torques: np.ndarray | None) -> ArmSituation:
    return ArmSituation(HOME_ARM, joints, torques)


@pytest.mark.parametrize(
    ("joints", "torques", "jammed", "free"),
    [
        (CLOSED, PRESSING, False, False),
        (CLOSED, LIMP, False, True),
        (CLOSED, THUMB_ALONE, False, True),
        (CLOSED, NO_GRIP, False, True),
        (CLOSED, None, False, False),
        (OPENED, LIMP, False, True),
        (OPENED, PRESSING, False, True),
        (OPENED, LIMP, True, True),
        (left_flexed(2), PUSHING_OPEN, True, True),
        (left_flexed(0, 2), PUSHING_OPEN, True, False),
        (CLOSED, PUSHING_OPEN, True, False),
        (CLOSED, LIMP, True, False),
    ],
    ids=[
        "holds", "dropped out", "thumb alone presses", "nothing that grips presses", "no torques", "opened",
        "opened, still pressing", "opened with a fault", "one jammed", "two jammed", "all jammed",
        "all jammed, drives off",
    ],
)  # fmt: skip
def test_whether_a_hand_that_was_ended_while_it_opened_has_let_go(
    joints: np.ndarray, torques: np.ndarray | None, jammed: bool, free: bool
) -> None:
    assert has_let_go(hand(CLOSED, PRESSING), hand(joints, torques), jammed) is free


def test_fingers_that_did_not_hold_are_not_waited_for() -> None:
    assert has_let_go(hand(left_flexed(0, 2), PRESSING), hand(OPENED, PRESSING), jammed=True)


@pytest.mark.parametrize("before", [LIMP, None], ids=["a driver that fills in zeros", "none"])
def test_torques_that_never_told_anything_tell_nothing(before: np.ndarray | None) -> None:
    assert not has_let_go(hand(CLOSED, before), hand(CLOSED, LIMP), jammed=False)


def test_a_grip_is_lost_where_fingers_that_pressed_do_not_any_more() -> None:
    gripping, limp, mute = (hand(CLOSED, torques) for torques in (PRESSING, LIMP, None))
    assert grip_lost(gripping, limp)
    assert grip_lost(gripping, hand(CLOSED, THUMB_ALONE))
    assert not grip_lost(gripping, gripping)
    assert not grip_lost(limp, limp), "a hand that never showed torques says nothing"
    assert not grip_lost(mute, mute)
    assert not grip_lost(gripping, mute)
