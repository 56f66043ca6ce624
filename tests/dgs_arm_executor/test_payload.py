from __future__ import annotations

import pytest

from dgs_arm_executor.executor_parameters import ArmExecutorParameters
from dgs_arm_executor.payload import Payload


def test_object_at_the_tcp_shifts_the_centre_of_gravity() -> None:
    load = Payload(1.5, (0.0, 0.0, 0.09)).with_object(0.5, at=(0.04, 0.0, 0.17))
    assert load.mass == 2.0
    assert load.centre == pytest.approx((0.01, 0.0, 0.11))


def test_nothing_weighs_nothing() -> None:
    bare = Payload(0.0, (0.0, 0.0, 0.0))
    assert bare.with_object(0.0) == bare


def test_parameters_give_the_load_with_and_without_an_object() -> None:
    given = ArmExecutorParameters(hand_mass=1.4, object_mass=0.3)
    assert given.payload(False) == Payload(1.4, given.hand_centre_of_mass)
    assert given.payload(True).mass == pytest.approx(1.7)
    assert given.payload(True).centre[2] > given.hand_centre_of_mass[2]
