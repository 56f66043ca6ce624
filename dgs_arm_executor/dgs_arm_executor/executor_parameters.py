"""Parameters of the arm executor's node."""

from __future__ import annotations

from dataclasses import dataclass

from dgs_arm_executor.grasp_state import HoldSettings
from dgs_arm_executor.obstacle_cloud import CloudSettings
from dgs_arm_executor.paths import PathSettings
from dgs_arm_executor.payload import Payload
from dgs_arm_executor.pick_types import HOME, PickSettings
from dgs_arm_executor.planning_scene import SceneSettings
from dgs_arm_executor.safety import Envelope
from dgs_arm_executor.table_check import TableBounds
from dgs_arm_executor.watch import WatchSettings
from dgs_ros.parameters import parameter

_Six = tuple[float, float, float, float, float, float]
_Triple = tuple[float, float, float]


@dataclass(frozen=True)
class ArmExecutorParameters:
    """Names on the robot's side, geometry and speeds of a pick, clearances, timeouts, safety envelope."""

    controller_name: str = parameter(
        "scaled_joint_trajectory_controller", "Controller whose follow_joint_trajectory action moves the arm."
    )
    cloud_topic: str = parameter("/dgs/cloud", "Observed cloud in base_link; empty = plan without.")
    max_cloud_age: float = parameter(
        10.0, "No pick is planned on an older cloud (time since arrival) [s].", minimum=0.1, maximum=3600.0
    )
    home: _Six = parameter(
        tuple(round(v, 6) for v in HOME.tolist()), "Home posture [rad].", minimum=-6.2832, maximum=6.2832
    )
    stand_off: float = parameter(
        0.10, "Start of the straight approach, back along the TCP's z [m].", minimum=0.02, maximum=0.3
    )
    lift: float = parameter(0.15, "Straight lift after closing [m].", minimum=0.02, maximum=0.4)
    release_clearance: float = parameter(
        0.05, "Between the bin's rim and the object [m].", minimum=0.0, maximum=0.4
    )
    speed: float = parameter(
        0.6, "Share of the joint velocity limits, transfer and home.", minimum=0.01, maximum=1.0
    )
    carry_speed: float = parameter(0.4, "The same while carrying.", minimum=0.01, maximum=1.0)
    approach_speed: float = parameter(0.15, "TCP speed of the approach [m/s].", minimum=0.005, maximum=0.5)
    lift_speed: float = parameter(0.15, "TCP speed of the lift [m/s].", minimum=0.005, maximum=0.5)
    hand_speed: float = parameter(
        0.0, "Of every hand joint; 0 = the hand driver's default [rad/s].", minimum=0.0, maximum=3.14
    )
    trajectory_rate: float = parameter(
        50.0, "Points per second of a trajectory [Hz].", minimum=10.0, maximum=500.0
    )
    planning_time: float = parameter(10.0, "Limit of one planning [s].", minimum=0.1, maximum=120.0)
    path_time: float = parameter(
        0.6, "Limit of one query of the sampling planner [s].", minimum=0.05, maximum=30.0
    )
    arm_clearance: float = parameter(
        0.005, "Robot and what it carries to the cell and to itself [m].", minimum=0.0, maximum=0.1
    )
    hand_table_clearance: float = parameter(
        0.0, "Open hand to the table; negative forgives [m].", minimum=-0.02, maximum=0.05
    )
    closed_table_clearance: float = parameter(
        -0.012, "Closed hand to the table: compliant fingers may touch it [m].", minimum=-0.03, maximum=0.05
    )
    cloud_resolution: float = parameter(
        0.008, "Voxel of the obstacle cloud [m].", minimum=0.003, maximum=0.05
    )
    release_radius: float = parameter(
        0.12,
        "The target's points this near to the TCP do not count on the approach [m].",
        minimum=0.02,
        maximum=0.4,
    )
    closing_margin: _Triple = parameter(
        (0.0, 0.20, 0.14),
        "The hand driver's closing_margin: yaw, pitch, middle [rad].",
        minimum=0.0,
        maximum=0.5,
    )
    held_shortfall: float = parameter(
        0.05,
        "A finger this far before its closing target is held off by an object [rad].",
        minimum=0.01,
        maximum=0.5,
    )
    held_fingers: int = parameter(2, "So many fingers held off: an object is held.", minimum=1, maximum=5)
    check_extrinsics: bool = parameter(
        True, "Refuse to move where the observed table is not where the camera's pose says."
    )
    extrinsics_tilt: float = parameter(
        0.02, "Largest tilt of the observed table [rad].", minimum=0.001, maximum=0.3
    )
    extrinsics_height: float = parameter(0.01, "Largest error of its height [m].", minimum=0.001, maximum=0.1)
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
        0.2,
        "Silence of /joint_states that aborts; ten times that of the hand [s of node time].",
        minimum=0.02,
        maximum=5.0,
    )
    wall_timeout: float = parameter(
        5.0,
        "Silence in wall time that aborts although simulated time stands still [s].",
        minimum=0.5,
        maximum=60.0,
    )
    ready_timeout: float = parameter(
        5.0, "How long a goal waits for servers and states [s].", minimum=0.1, maximum=60.0
    )
    start_tolerance: float = parameter(
        0.05, "Largest way between planned and measured start of a motion [rad].", minimum=0.001, maximum=0.5
    )
    goal_time_tolerance: float = parameter(
        2.0, "The controller may be late by so much [s].", minimum=0.0, maximum=60.0
    )
    timeout_factor: float = parameter(
        2.0, "A motion may take so many times its duration.", minimum=1.0, maximum=20.0
    )
    timeout_extra: float = parameter(4.0, "And so much more [s].", minimum=0.1, maximum=60.0)
    workspace_lower: _Triple = parameter((-0.70, -0.70, -0.22), "Corner of the box the TCP stays in [m].")
    workspace_upper: _Triple = parameter((0.62, 0.70, 1.00), "Opposite corner [m].")
    table_penetration: float = parameter(
        0.015, "No point of the hand goes farther below the table top [m].", minimum=0.0, maximum=0.03
    )

    def pick(self) -> PickSettings:
        """For the pick planner."""
        return PickSettings(
            home=self.home,
            stand_off=self.stand_off,
            lift=self.lift,
            release_clearance=self.release_clearance,
            speed=self.speed,
            carry_speed=self.carry_speed,
            approach_speed=self.approach_speed,
            lift_speed=self.lift_speed,
            rate=self.trajectory_rate,
            time_limit=self.planning_time,
            path=PathSettings(timeout=self.path_time),
        )

    def scene(self) -> SceneSettings:
        """Clearances."""
        return SceneSettings(
            arm_clearance=self.arm_clearance,
            hand_table_clearance=self.hand_table_clearance,
            closed_table_clearance=self.closed_table_clearance,
            tcp_lower=self.workspace_lower,
            tcp_upper=self.workspace_upper,
        )

    def cloud(self) -> CloudSettings:
        """For the obstacle cloud."""
        return CloudSettings(
            resolution=self.cloud_resolution,
            link_distance=2.1 * self.cloud_resolution,
            release_radius=self.release_radius,
        )

    def hold(self) -> HoldSettings:
        """When the hand counts as holding."""
        return HoldSettings(self.closing_margin, self.held_shortfall, fingers=self.held_fingers)

    def envelope(self) -> Envelope:
        """For the safety check."""
        return Envelope(
            tcp_lower=self.workspace_lower,
            tcp_upper=self.workspace_upper,
            table_penetration=self.table_penetration,
        )

    def payload(self, holding: bool) -> Payload:
        """The load at the flange with or without an object."""
        hand = Payload(self.hand_mass, self.hand_centre_of_mass)
        return hand.with_object(self.object_mass) if holding else hand

    def table_bounds(self) -> TableBounds:
        """For the check of the camera's pose."""
        return TableBounds(self.extrinsics_tilt, self.extrinsics_height)

    def watch(self) -> WatchSettings:
        """When the robot counts as silent."""
        return WatchSettings(self.joint_state_timeout, self.wall_timeout)
