from __future__ import annotations

import pytest

from dgs_arm_executor.ik import T_TOOL0_TCP
from dgs_arm_executor.situation import payload


def test_object_at_the_tcp_shifts_the_centre_of_gravity() -> None:
    mass, centre = payload(1.5, (0.0, 0.0, 0.09), 0.5)
    assert mass == 2.0
    assert centre == pytest.approx(0.75 * 0.0 + 0.25 * T_TOOL0_TCP[:3, 3] + (0.0, 0.0, 0.75 * 0.09))


def test_the_hand_alone() -> None:
    mass, centre = payload(1.4, (0.01, 0.02, 0.09))
    assert mass == 1.4 and centre == pytest.approx((0.01, 0.02, 0.09))


def test_a_hand_that_nobody_weighed_is_that_of_the_model() -> None:
    mass, centre = payload(0.0, (9.0, 9.0, 9.0))
    assert mass == pytest.approx(1.507)
    assert centre == pytest.approx((0.012, 0.002, 0.089), abs=5e-4)
