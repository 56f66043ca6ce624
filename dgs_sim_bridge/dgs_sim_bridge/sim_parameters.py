"""Parameters of the simulator node. No ROS."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dgs_ros.parameters import parameter
from dgs_sim_bridge.world.trajectory import Tolerances


@dataclass(frozen=True)
class SimParameters:
    """See the descriptions."""

    objects: int = parameter(5, "Objects of the first scene.", minimum=0, maximum=30)
    seed: int = parameter(0, "Seed of the first scene and of the camera's noise.", minimum=0)
    catalogue: str = parameter("novel", "Objects to draw from: novel, train, or a file or folder.")
    models_dir: str = parameter(
        "", "Folder with the catalogues; empty = $DGS_MODELS_DIR or the repository's models."
    )
    real_time_factor: float = parameter(
        1.0,
        "Simulated seconds per second where the machine can; 0 = as fast as possible.",
        minimum=0.0,
        maximum=100.0,
    )
    arm_action: str = parameter(
        "/scaled_joint_trajectory_controller/follow_joint_trajectory",
        "Name of the FollowJointTrajectory action.",
    )
    path_tolerance: float = parameter(0.2, "Allowed deviation on the way [rad].", minimum=0.001, maximum=3.0)
    goal_tolerance: float = parameter(0.1, "Allowed deviation at the end [rad].", minimum=0.0005, maximum=3.0)
    goal_time_tolerance: float = parameter(
        5.0,
        "How much later than planned a goal may be reached, if it does not say so itself [s].",
        minimum=0.01,
    )
    joint_state_rate: float = parameter(
        125.0, "Arm joint states [Hz, simulated].", minimum=1.0, maximum=240.0
    )
    clock_rate: float = parameter(50.0, "Clock messages [Hz, simulated].", minimum=1.0, maximum=240.0)
    hand_host: str = parameter("127.0.0.1", "Address on which the hand's CAN bus (socketcand) listens.")
    hand_port: int = parameter(
        29536, "TCP port of the hand's CAN bus; 0 = any free one.", minimum=0, maximum=65535
    )
    camera_namespace: str = parameter("/camera/camera", "Prefix of the camera's topics, as of realsense-ros.")
    camera_rate: float = parameter(
        2.0, "Pictures while somebody listens [Hz, simulated].", minimum=0.1, maximum=30.0
    )
    camera_noise: bool = parameter(True, "Whether depth has the errors of a D455.")

    def tolerances(self) -> Tolerances:
        """Of goals that do not say so themselves."""
        return Tolerances(
            path=np.full(6, self.path_tolerance),
            goal=np.full(6, self.goal_tolerance),
            goal_time=self.goal_time_tolerance,
        )
