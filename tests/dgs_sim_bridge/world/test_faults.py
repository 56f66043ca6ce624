import numpy as np
import pytest

from dgs_description.errors import ErrorCode
from dgs_sim_bridge.world.faults import Faults
from tests.support.refused import refused


@pytest.mark.parametrize(
    ("fault", "target", "duration", "code"),
    [
        ("set_on_fire", "", 0.0, ErrorCode.SIM_FAULT_UNKNOWN),
        ("", "", 0.0, ErrorCode.SIM_FAULT_UNKNOWN),
        ("jam_finger", "", 0.0, ErrorCode.SIM_REQUEST),
        ("jam_finger", "pinky", 0.0, ErrorCode.SIM_REQUEST),
        ("freeze_camera", "", -1.0, ErrorCode.SIM_REQUEST),
        ("freeze_camera", "", np.nan, ErrorCode.SIM_REQUEST),
        ("freeze_camera", "", np.inf, ErrorCode.SIM_REQUEST),
    ],
)
def test_bad_requests_are_refused(fault: str, target: str, duration: float, code: ErrorCode) -> None:
    with refused(code):
        Faults.check(fault, target, duration)


def test_good_requests_pass() -> None:
    for fault in ("freeze_camera", "drop_joint_states", "protective_stop", "abort_arm_goal", "clear"):
        Faults.check(fault, "", 0.0)
    Faults.check("jam_finger", "index", 2.5)


def test_fault_lasts_for_its_duration() -> None:
    faults = Faults()
    faults.inject("freeze_camera", "", 2.0, now=10.0)
    faults.expire(11.9)
    assert faults.on("freeze_camera") and not faults.on("protective_stop")
    faults.expire(12.0)
    assert not faults.on("freeze_camera")


def test_fault_without_duration_lasts_until_clear() -> None:
    faults = Faults()
    faults.inject("protective_stop", "", 0.0, now=1.0)
    faults.inject("jam_finger", "ring", 0.0, now=1.0)
    faults.expire(1e9)
    assert faults.names == ["jam_finger ring", "protective_stop"]
    faults.inject("clear", "", 0.0, now=2.0)
    assert faults.names == []


def test_jammed_fingers() -> None:
    faults = Faults()
    faults.inject("jam_finger", "ring", 0.0, now=0.0)
    faults.inject("jam_finger", "thumb", 1.0, now=0.0)
    np.testing.assert_array_equal(faults.jammed, [True, False, False, True, False])
    faults.expire(1.0)
    np.testing.assert_array_equal(faults.jammed, [False, False, False, True, False])


def test_taking_ends_a_fault_without_duration_only() -> None:
    faults = Faults()
    faults.inject("abort_arm_goal", "", 0.0, now=0.0)
    assert faults.take("abort_arm_goal") and not faults.take("abort_arm_goal")
    faults.inject("abort_arm_goal", "", 5.0, now=0.0)
    assert faults.take("abort_arm_goal") and faults.take("abort_arm_goal")
