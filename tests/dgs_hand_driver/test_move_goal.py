import random

import numpy as np
import pytest

from dgs_description.errors import ErrorCode
from dgs_description.hand import HAND
from dgs_description.hand_file import load_hand
from dgs_description.joints import reorder
from dgs_hand_driver.move_goal import DEFAULT_SPEED, parse_goal
from tests.support.refused import refused

NAMES = list(HAND.joints)
POSITIONS = [0.1, 0.5, 0.3, 0.3] * 5
NAN, INF = float("nan"), float("inf")


def changed(name: str, value: float) -> list[float]:
    return [value if n == name else p for n, p in zip(NAMES, POSITIONS, strict=True)]


def test_twenty_joints_in_any_order() -> None:
    pairs = list(zip(NAMES, np.linspace(0.0, 0.25, 20) // 0.02 * 0.02, strict=True))
    pairs = [(n, dict(pairs)[n.replace("joint4", "joint3")]) for n, _ in pairs]
    random.Random(3).shuffle(pairs)
    names, values = zip(*pairs, strict=True)
    goal = parse_goal(names, values, 0.5, 0)
    assert np.array_equal(goal.target, reorder(names, values, HAND.joints))
    assert (goal.speed, goal.mode) == (0.5, "position")


def test_fifteen_joints_fill_in_the_coupled_ones() -> None:
    goal = parse_goal(HAND.driven_joints[::-1], ([0.3, 0.5, 0.1] * 5), 0.0, 1)
    assert np.allclose(goal.target, POSITIONS)
    assert (goal.speed, goal.mode) == (DEFAULT_SPEED, "grasp")
    for fastest, speed in ((2.0, 0.7), (0.5, 0.5)):
        assert parse_goal(NAMES, POSITIONS, 0.0, 0, (), 0.7, fastest).speed == speed


def test_rounding_is_forgiven_and_clipped() -> None:
    goal = parse_goal(NAMES, changed("index_joint2", HAND.upper[5] + 5e-4), 1.0, 0)
    assert goal.target[5] == HAND.upper[5]
    goal = parse_goal(NAMES, changed("index_joint4", 0.305), 1.0, 0)
    assert goal.target[7] == goal.target[6] == 0.3


def test_distal_joints_that_have_motors_go_where_they_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    hand = load_hand("allegro")
    monkeypatch.setattr("dgs_hand_driver.move_goal.HAND", hand)
    wanted = np.clip(np.linspace(0.3, 0.6, hand.joint_count), hand.lower, hand.upper)
    assert np.array_equal(parse_goal(hand.joints, wanted, 0.5, 0).target, wanted)


def test_active_fingers_are_taken_as_stated_or_left_open() -> None:
    stated = [True, False, True, False, False]
    assert parse_goal(NAMES, POSITIONS, 1.0, 1).active is None
    goal = parse_goal(NAMES, POSITIONS, 1.0, 1, stated)
    assert goal.active is not None and goal.active.tolist() == stated


@pytest.mark.parametrize(("count", "said"), [(1, "1 flag;"), (4, "4 flags;"), (20, "20 flags;")])
def test_active_fingers_of_another_number_are_refused(count: int, said: str) -> None:
    with refused(ErrorCode.HAND_JOINT_NAMES, f"active_fingers has {said} .*thumb.*little, or none"):
        parse_goal(NAMES, POSITIONS, 1.0, 1, [True] * count)


@pytest.mark.parametrize(
    ("names", "positions", "speed", "mode", "code", "sentence"),
    [
        (NAMES, POSITIONS, 1.0, 2, ErrorCode.HAND_MODE, "unknown mode 2"),
        (NAMES, POSITIONS[:-1], 1.0, 0, ErrorCode.HAND_JOINT_NAMES, "20 joint names came with 19"),
        ([], [], 1.0, 0, ErrorCode.HAND_JOINT_NAMES, "missing joints"),
        (NAMES[:-1], POSITIONS[:-1], 1.0, 0, ErrorCode.HAND_JOINT_NAMES, "missing joints: little_joint4"),
        (NAMES[1:], POSITIONS[1:], 1.0, 0, ErrorCode.HAND_JOINT_NAMES, "missing joints: thumb_joint1"),
        (
            [*NAMES[:-1], "tail_joint"],
            POSITIONS,
            1.0,
            0,
            ErrorCode.HAND_JOINT_NAMES,
            "not of this hand: tail_joint",
        ),
        (
            [*NAMES, NAMES[0]],
            [*POSITIONS, 0.1],
            1.0,
            0,
            ErrorCode.HAND_JOINT_NAMES,
            "more than once: thumb_joint1",
        ),
        (NAMES, changed("ring_joint2", NAN), 1.0, 0, ErrorCode.HAND_NOT_FINITE, "ring_joint2"),
        (NAMES, changed("ring_joint2", -INF), 1.0, 1, ErrorCode.HAND_NOT_FINITE, "ring_joint2"),
        (NAMES, POSITIONS, NAN, 0, ErrorCode.HAND_NOT_FINITE, "speed"),
        (
            NAMES,
            changed("thumb_joint1", 0.3),
            1.0,
            0,
            ErrorCode.HAND_LIMIT,
            "thumb_joint1 = 0.3000 .* to 0.2618",
        ),
        (NAMES, changed("little_joint2", -0.01), 1.0, 0, ErrorCode.HAND_LIMIT, "little_joint2 = -0.0100"),
        (
            NAMES,
            changed("index_joint4", 0.35),
            1.0,
            0,
            ErrorCode.HAND_COUPLING,
            "index_joint4 = 0.3500 .*index_joint3",
        ),
        (NAMES, POSITIONS, -1.0, 0, ErrorCode.HAND_SPEED, "speed -1 "),
        (NAMES, POSITIONS, 0.001, 0, ErrorCode.HAND_SPEED, "0.02 to 2.09"),
        (NAMES, POSITIONS, 2.1, 0, ErrorCode.HAND_SPEED, "speed 2.1 "),
    ],
)
def test_refusals(names, positions, speed, mode, code, sentence) -> None:
    with refused(code, sentence):
        parse_goal(names, positions, speed, mode)
