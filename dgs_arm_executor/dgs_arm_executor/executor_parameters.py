"""Parameters of the arm executor's node: names on the robot's side, and the settings of the executor's parts."""

from __future__ import annotations

from dataclasses import dataclass

from dgs_arm_executor.force_guard import MAX_FORCE
from dgs_arm_executor.grasp_state import HoldSettings
from dgs_arm_executor.pick_plan import PickSettings
from dgs_arm_executor.planning_scene import SceneSettings
from dgs_arm_executor.table_check import MAX_HEIGHT, MAX_TILT
from dgs_arm_executor.watch import SILENCE
from dgs_description.hand import HAND
from dgs_description.parameters import parameter

_Triple = tuple[float, float, float]


@dataclass(frozen=True)
class ArmExecutorParameters(HoldSettings, SceneSettings, PickSettings):
    """Names on the robot's side, geometry and speeds of a pick, clearances, safety envelope."""

    controller_name: str = parameter(
        "scaled_joint_trajectory_controller", "Controller whose follow_joint_trajectory action moves the arm."
    )
    cloud_topic: str = parameter(
        "/dgs/cloud", "Observed cloud in base_link; empty = plan without.", optional=True
    )
    max_cloud_age: float = parameter(
        10.0, "No pick is planned on an older cloud (time since arrival) [s].", 0.1, 3600.0
    )
    wrench_topic: str = parameter(
        "/force_torque_sensor_broadcaster/wrench",
        "Force on the hand, in tool0; empty = it is not bounded.",
        optional=True,
    )
    max_force: float = parameter(
        MAX_FORCE, "Of the hand on anything, on straight ways near the table; 0 = no bound [N].", 0.0, 150.0
    )
    hand_speed: float = parameter(
        0.0,
        "Of every hand joint, but for closing, where the driver's default counts; 0 = the hand's own [rad/s].",
        0.0,
        3.14,
    )
    check_extrinsics: bool = parameter(
        True, "Refuse to move where the observed table is not where the camera's pose says."
    )
    extrinsics_tilt: float = parameter(MAX_TILT, "Largest tilt of the observed table [rad].", 0.001, 0.3)
    extrinsics_height: float = parameter(MAX_HEIGHT, "Largest error of its height [m].", 0.001, 0.1)
    payload_service: str = parameter(
        "/io_and_status_controller/set_payload",
        "The UR driver's service; empty = the payload is not set.",
        optional=True,
    )
    hand_mass: float = parameter(
        0.0, "Hand and adapter [kg]; 0 = the hand alone, mass and centre as its model has them.", 0.0, 10.0
    )
    hand_centre_of_mass: _Triple = parameter(
        (0.0, 0.0, 0.09), "Their centre of gravity in tool0, where hand_mass is given [m].", -0.5, 0.5
    )
    object_mass: float = parameter(0.2, "Assumed mass of a held object, at the TCP [kg].", 0.0, 3.0)
    # Silence is counted in steps of `watch.TICK`.
    joint_state_timeout: float = parameter(
        SILENCE,
        "Silence of the arm's joint states that aborts; of the hand's ten times as long [s of node time].",
        0.1,
        5.0,
    )
    start_tolerance: float = parameter(
        0.05, "Largest way between planned and measured start of a motion [rad].", 0.001, 0.5
    )

    @property
    def shaping_speed(self) -> float:
        """Of every hand joint on the way to a shape [rad/s]."""
        return self.hand_speed or HAND.speed
