from __future__ import annotations

import numpy as np

from dgs_arm_executor.grasp_state import (
    HoldSettings,
    dropped_out,
    fingers_held_off,
    let_go,
    names,
    object_held,
)
from dgs_description.hand_model import pre_grasp

GRASP = np.tile([0.0, 0.6, 0.4, 0.4], 5)
PRE = pre_grasp(GRASP)
MARGIN = np.tile([0.0, 0.20, 0.14, 0.14], 5)


def closed(held: list[int], short: float = 0.15) -> np.ndarray:
    joints = (GRASP + MARGIN).reshape(5, 4).copy()
    joints[held, 1] -= short
    return joints.ravel()


def test_an_empty_hand_reaches_its_target() -> None:
    assert not object_held(GRASP + MARGIN, PRE, GRASP)
    assert not object_held(GRASP + MARGIN - 0.02, PRE, GRASP)


def test_fingers_before_their_target_hold_something() -> None:
    held = fingers_held_off(closed([1, 2, 4]), PRE, GRASP, HoldSettings(own_contact=-1.0))
    assert held.tolist() == [False, True, True, False, True]
    assert names(held) == "index, middle, little"
    assert object_held(closed([1, 4]), PRE, GRASP, HoldSettings(own_contact=-1.0))


def test_one_jammed_finger_is_no_object() -> None:
    assert not object_held(closed([4]), PRE, GRASP)


def test_idle_fingers_do_not_count() -> None:
    pre = PRE.reshape(5, 4).copy()
    pre[3:] = GRASP.reshape(5, 4)[3:]
    assert not object_held(closed([3, 4]), pre.ravel(), GRASP)


def test_the_thumb_against_a_finger_is_no_object() -> None:
    # Thumb, index and middle finger meet in this posture; all stand far before their targets.
    grasp = np.tile([0.0, 1.2, 0.9, 0.9], 5)
    meeting = np.zeros((5, 4))
    meeting[:] = [0.0, 0.6, 0.3, 0.3]
    held = fingers_held_off(meeting, np.zeros(20), grasp)
    free = fingers_held_off(meeting, np.zeros(20), grasp, HoldSettings(own_contact=-1.0))
    assert free.all() and held.tolist() == [False, False, False, True, True]
    assert names(np.zeros(5, dtype=bool)) == "no finger"


def test_a_jammed_finger_alone_holds_nothing_but_two_may() -> None:
    held = np.tile([0.0, 0.5, 0.4, 0.4], 5)
    assert not let_go(held, held)
    one_left, two_left = (np.zeros(20) for _ in range(2))
    one_left[8:12] = held[8:12]
    two_left[:4], two_left[8:12] = held[:4], held[8:12]
    assert let_go(np.zeros(20), held)
    assert let_go(one_left, held)
    assert not let_go(two_left, held)


HELD = np.zeros((5, 4))
HELD[:3, 1] = 0.3


def test_fingers_that_do_not_press_any_more_have_dropped_it() -> None:
    assert dropped_out(np.zeros(20), HELD)
    assert not dropped_out(HELD, HELD)
    thumb_alone = np.zeros((5, 4))
    thumb_alone[0, 2] = 0.3
    assert dropped_out(thumb_alone, HELD)
    not_in_the_way_of_gripping = np.tile(
        [0.3, 0.0, 0.0, 0.3], 5
    )  # yaw; the distal joint has no drive of its own
    assert dropped_out(not_in_the_way_of_gripping, HELD)


def test_torques_that_never_told_anything_tell_nothing() -> None:
    assert not dropped_out(np.zeros(20), np.zeros(20)), "a driver that fills in zeros"
    assert not dropped_out(None, HELD) and not dropped_out(np.zeros(20), None)
