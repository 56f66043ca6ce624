"""Parameters of the arm executor's node. What a part of the executor sets by default, it takes from there."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

from dgs_arm_executor.grasp_state import HoldSettings
from dgs_arm_executor.pick_plan import PickSettings
from dgs_arm_executor.planning_scene import SceneSettings
from dgs_arm_executor.safety import Envelope
from dgs_arm_executor.table_check import TableBounds
from dgs_arm_executor.watch import SILENCE
from dgs_description.frames import HOME_ARM
from dgs_ros.parameters import parameter, parameter_of

_pick, _scene, _hold, _bounds, _envelope = (
    partial(parameter_of, settings)
    for settings in (PickSettings, SceneSettings, HoldSettings, TableBounds, Envelope)
)
_HOME = tuple(HOME_ARM.round(6).tolist())
_Six = tuple[float, float, float, float, float, float]
_Triple = tuple[float, float, float]


@dataclass(frozen=True)
class ArmExecutorParameters:
    """Names on the robot's side, geometry and speeds of a pick, clearances, safety envelope."""

    controller_name: str = parameter(
        "scaled_joint_trajectory_controller", "Controller whose follow_joint_trajectory action moves the arm."
    )
    cloud_topic: str = parameter("/dgs/cloud", "Observed cloud in base_link; empty = plan without.")
    max_cloud_age: float = parameter(
        10.0, "No pick is planned on an older cloud (time since arrival) [s].", 0.1, 3600.0
    )
    home: _Six = parameter(_HOME, "Home posture [rad].", -6.2832, 6.2832, origin=(PickSettings, "home"))
    stand_off: float = _pick(
        "stand_off", "Start of the straight approach, back along the TCP's z [m].", 0.02, 0.3
    )
    lift: float = _pick("lift", "Straight lift after closing [m].", 0.02, 0.4)
    release_clearance: float = _pick(
        "release_clearance", "Between the bin's rim and the object [m].", 0.0, 0.4
    )
    speed: float = _pick("speed", "Share of the joint velocity limits, transfer and home.", 0.01, 1.0)
    carry_speed: float = _pick("carry_speed", "The same while carrying.", 0.01, 1.0)
    approach_speed: float = _pick("approach_speed", "TCP speed of the approach [m/s].", 0.005, 0.5)
    lift_speed: float = _pick("lift_speed", "TCP speed of the lift [m/s].", 0.005, 0.5)
    hand_speed: float = parameter(
        0.0, "Of every hand joint; 0 = the hand driver's default [rad/s].", 0.0, 3.14
    )
    planning_time: float = _pick("planning_time", "Limit of one planning [s].", 0.1, 120.0)
    arm_clearance: float = _scene(
        "arm_clearance", "Robot and what it carries to the cell and to itself [m].", 0.0, 0.1
    )
    hand_table_clearance: float = _scene(
        "hand_table_clearance", "Open hand to the table; negative forgives [m].", -0.02, 0.05
    )
    closed_table_clearance: float = _scene(
        "closed_table_clearance", "Closed hand to the table: compliant fingers may touch it [m].", -0.03, 0.05
    )
    held_shortfall: float = _hold(
        "held_shortfall",
        "A finger this far before its closing target is held off by an object [rad].",
        0.01,
        0.5,
    )
    check_extrinsics: bool = parameter(
        True, "Refuse to move where the observed table is not where the camera's pose says."
    )
    extrinsics_tilt: float = _bounds("tilt", "Largest tilt of the observed table [rad].", 0.001, 0.3)
    extrinsics_height: float = _bounds("height", "Largest error of its height [m].", 0.001, 0.1)
    payload_service: str = parameter(
        "/io_and_status_controller/set_payload", "The UR driver's service; empty = the payload is not set."
    )
    hand_mass: float = parameter(1.5, "Hand and adapter [kg].", 0.0, 10.0)
    hand_centre_of_mass: _Triple = parameter(
        (0.012, 0.002, 0.089), "Their centre of gravity in tool0 [m].", -0.5, 0.5
    )
    object_mass: float = parameter(0.2, "Assumed mass of a held object, at the TCP [kg].", 0.0, 3.0)
    joint_state_timeout: float = parameter(
        SILENCE,
        "Silence of /joint_states that aborts; ten times that of the hand [s of node time].",
        0.02,
        5.0,
    )
    start_tolerance: float = parameter(
        0.05, "Largest way between planned and measured start of a motion [rad].", 0.001, 0.5
    )
    workspace_lower: _Triple = _envelope("workspace_lower", "Corner of the box the TCP stays in [m].")
    workspace_upper: _Triple = _envelope("workspace_upper", "Opposite corner [m].")
    table_penetration: float = _envelope(
        "table_penetration", "No point of the hand goes farther below the table top [m].", 0.0, 0.03
    )
