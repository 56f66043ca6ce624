"""Parameters of the arm executor's node. What a part of the executor sets by default, it takes from there."""

from __future__ import annotations

from dataclasses import dataclass

from dgs_arm_executor.grasp_state import HoldSettings
from dgs_arm_executor.pick_plan import PickSettings
from dgs_arm_executor.planning_scene import SceneSettings
from dgs_arm_executor.safety import Envelope
from dgs_arm_executor.table_check import TableBounds
from dgs_arm_executor.watch import SILENCE
from dgs_ros.parameters import parameter, parameter_of, settings_of

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
        10.0, "No pick is planned on an older cloud (time since arrival) [s].", minimum=0.1, maximum=3600.0
    )
    home: _Six = parameter(
        tuple(round(v, 6) for v in PickSettings.home), "Home posture [rad].", minimum=-6.2832, maximum=6.2832
    )
    stand_off: float = parameter_of(
        PickSettings,
        "stand_off",
        "Start of the straight approach, back along the TCP's z [m].",
        minimum=0.02,
        maximum=0.3,
    )
    lift: float = parameter_of(
        PickSettings, "lift", "Straight lift after closing [m].", minimum=0.02, maximum=0.4
    )
    release_clearance: float = parameter_of(
        PickSettings,
        "release_clearance",
        "Between the bin's rim and the object [m].",
        minimum=0.0,
        maximum=0.4,
    )
    speed: float = parameter_of(
        PickSettings,
        "speed",
        "Share of the joint velocity limits, transfer and home.",
        minimum=0.01,
        maximum=1.0,
    )
    carry_speed: float = parameter_of(
        PickSettings, "carry_speed", "The same while carrying.", minimum=0.01, maximum=1.0
    )
    approach_speed: float = parameter_of(
        PickSettings, "approach_speed", "TCP speed of the approach [m/s].", minimum=0.005, maximum=0.5
    )
    lift_speed: float = parameter_of(
        PickSettings, "lift_speed", "TCP speed of the lift [m/s].", minimum=0.005, maximum=0.5
    )
    hand_speed: float = parameter(
        0.0, "Of every hand joint; 0 = the hand driver's default [rad/s].", minimum=0.0, maximum=3.14
    )
    planning_time: float = parameter_of(
        PickSettings, "planning_time", "Limit of one planning [s].", minimum=0.1, maximum=120.0
    )
    arm_clearance: float = parameter_of(
        SceneSettings,
        "arm_clearance",
        "Robot and what it carries to the cell and to itself [m].",
        minimum=0.0,
        maximum=0.1,
    )
    hand_table_clearance: float = parameter_of(
        SceneSettings,
        "hand_table_clearance",
        "Open hand to the table; negative forgives [m].",
        minimum=-0.02,
        maximum=0.05,
    )
    closed_table_clearance: float = parameter_of(
        SceneSettings,
        "closed_table_clearance",
        "Closed hand to the table: compliant fingers may touch it [m].",
        minimum=-0.03,
        maximum=0.05,
    )
    closing_margin: _Triple = parameter_of(
        HoldSettings,
        "closing_margin",
        "The hand driver's closing_margin: yaw, pitch, middle [rad].",
        minimum=0.0,
        maximum=0.5,
    )
    held_shortfall: float = parameter_of(
        HoldSettings,
        "held_shortfall",
        "A finger this far before its closing target is held off by an object [rad].",
        minimum=0.01,
        maximum=0.5,
    )
    check_extrinsics: bool = parameter(
        True, "Refuse to move where the observed table is not where the camera's pose says."
    )
    extrinsics_tilt: float = parameter_of(
        TableBounds, "tilt", "Largest tilt of the observed table [rad].", minimum=0.001, maximum=0.3
    )
    extrinsics_height: float = parameter_of(
        TableBounds, "height", "Largest error of its height [m].", minimum=0.001, maximum=0.1
    )
    payload_service: str = parameter(
        "/io_and_status_controller/set_payload", "The UR driver's service; empty = the payload is not set."
    )
    hand_mass: float = parameter(1.5, "Hand and adapter [kg].", minimum=0.0, maximum=10.0)
    hand_centre_of_mass: _Triple = parameter(
        (0.012, 0.002, 0.089), "Their centre of gravity in tool0 [m].", minimum=-0.5, maximum=0.5
    )
    object_mass: float = parameter(
        0.2, "Assumed mass of a held object, at the TCP [kg].", minimum=0.0, maximum=3.0
    )
    joint_state_timeout: float = parameter(
        SILENCE,
        "Silence of /joint_states that aborts; ten times that of the hand [s of node time].",
        minimum=0.02,
        maximum=5.0,
    )
    start_tolerance: float = parameter(
        0.05, "Largest way between planned and measured start of a motion [rad].", minimum=0.001, maximum=0.5
    )
    workspace_lower: _Triple = parameter_of(
        Envelope, "workspace_lower", "Corner of the box the TCP stays in [m]."
    )
    workspace_upper: _Triple = parameter_of(Envelope, "workspace_upper", "Opposite corner [m].")
    table_penetration: float = parameter_of(
        Envelope,
        "table_penetration",
        "No point of the hand goes farther below the table top [m].",
        minimum=0.0,
        maximum=0.03,
    )

    def pick(self) -> PickSettings:
        """For the pick planner."""
        return settings_of(PickSettings, self, home=self.home)

    def scene(self) -> SceneSettings:
        """For the planning scene."""
        return settings_of(SceneSettings, self, envelope=settings_of(Envelope, self))
