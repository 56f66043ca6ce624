"""Arm forward kinematics: poses known from the DH parameters by hand."""

from __future__ import annotations

import numpy as np
import pytest

from dgs_description import arm_model

D1, D4, D5, D6 = 0.1519, 0.11235, 0.08535, 0.0819
A2, A3 = -0.24365, -0.21325


def test_stretched_arm_at_zero() -> None:
    # At zero the maker's arm lies along +x of base_link's opposite, -x of the DH base; base_link turns it back.
    T_base_tool0 = arm_model.forward_kinematics(np.zeros(6))
    np.testing.assert_allclose(T_base_tool0[:3, 3], [-(A2 + A3), D4 + D6, D1 - D5], atol=1e-12)
    np.testing.assert_allclose(T_base_tool0[:3, 2], [0, 1, 0], atol=1e-12)


def test_upright_arm() -> None:
    T_base_tool0 = arm_model.forward_kinematics([0, -np.pi / 2, 0, -np.pi / 2, 0, 0])
    np.testing.assert_allclose(T_base_tool0[:3, 3], [0, D4 + D6, D1 - A2 - A3 + D5], atol=1e-12)


@pytest.mark.parametrize("angle", [-2.0, 0.3, 3.0])
def test_pan_turns_everything_about_the_base_axis(angle: float) -> None:
    q = np.array([0.0, -1.2, 1.0, -0.5, 0.4, 0.2])
    turned = q + [angle, 0, 0, 0, 0, 0]
    cos, sin = np.cos(angle), np.sin(angle)
    turn = np.array([[cos, -sin, 0, 0], [sin, cos, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    expected = turn @ arm_model.forward_kinematics(q)
    np.testing.assert_allclose(arm_model.forward_kinematics(turned), expected, atol=1e-12)
