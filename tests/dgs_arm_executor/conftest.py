"""Parts that are slow to build, once for all tests of the arm executor's core."""

from __future__ import annotations

import pytest

from dgs_arm_executor.ik import ArmIK
from dgs_arm_executor.pick_plan import PickSettings
from dgs_arm_executor.pick_planner import PickPlanner


@pytest.fixture(scope="session")
def ik() -> ArmIK:
    return ArmIK()


@pytest.fixture(scope="session")
def planner(ik: ArmIK) -> PickPlanner:
    # Wall time, of a machine that does other things too.
    return PickPlanner(ik, PickSettings(planning_time=120.0))
