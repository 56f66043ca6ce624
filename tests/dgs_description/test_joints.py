"""Joint names, limits, and the look-up by name that everything relies on."""

from __future__ import annotations

import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dgs_description import joints
from dgs_description.errors import ErrorCode, JointNameError
from dgs_description.hand import HAND


def test_names_and_limits_fit_together() -> None:
    assert len(HAND.joints) == len(set(HAND.joints)) == 20
    assert len(HAND.driven_joints) == 15
    assert len(joints.ARM_JOINTS) == 6
    assert HAND.joints[:5] == (
        "thumb_joint1",
        "thumb_joint2",
        "thumb_joint3",
        "thumb_joint4",
        "index_joint1",
    )
    for values in (HAND.lower, HAND.upper, HAND.effort):
        assert values.shape == (20,)
    assert (HAND.lower < HAND.upper).all()
    assert (joints.ARM_LOWER < joints.ARM_UPPER).all()
    # Distal limits equal middle ones, or the coupling could not be kept.
    np.testing.assert_array_equal(HAND.split(HAND.upper)[:, 2], HAND.split(HAND.upper)[:, 3])


@given(st.permutations(HAND.joints))
def test_reorder_undoes_any_order(names: list[str]) -> None:
    values = {name: float(k) for k, name in enumerate(HAND.joints)}
    found = joints.reorder(names, [values[name] for name in names], HAND.joints)
    np.testing.assert_array_equal(found, np.arange(20.0))


def test_reorder_ignores_further_joints() -> None:
    np.testing.assert_array_equal(joints.reorder(["x", "b", "a"], [9, 2, 1], ["a", "b"]), [1, 2])


@pytest.mark.parametrize(
    ("names", "values", "words"),
    [
        (["a"], [1.0], "missing joints: b"),
        (["a", "b", "a"], [1.0, 2.0, 3.0], "more than once: a"),
        (["a", "b"], [1.0], "2 joint names came with 1 values"),
        ([], [], "missing joints: a, b"),
    ],
)
def test_reorder_refuses(names: list[str], values: list[float], words: str) -> None:
    with pytest.raises(JointNameError, match=words) as caught:
        joints.reorder(names, values, ["a", "b"])
    assert caught.value.code == ErrorCode.JOINT_NAMES


def test_many_doubled_names_are_refused_at_once() -> None:
    names = [f"joint{k % 10_000}" for k in range(20_000)]
    start = time.process_time()
    with pytest.raises(JointNameError, match="more than once: joint0, joint1, "):
        joints.reorder(names, [0.0] * len(names), HAND.joints)
    # Some milliseconds; counting anew for every name takes minutes.
    assert time.process_time() - start < 2.0


@pytest.mark.parametrize("batch", [(), (3,), (2, 3)])
def test_coupling_there_and_back(batch: tuple[int, ...]) -> None:
    active = np.random.default_rng(0).uniform(size=(*batch, 15))
    full = HAND.expand(active)
    assert full.shape == (*batch, 20)
    by_finger = full.reshape(*batch, 5, 4)
    np.testing.assert_array_equal(by_finger[..., 2], by_finger[..., 3])
    np.testing.assert_array_equal(HAND.reduce(full), active)
