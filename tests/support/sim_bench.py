"""A running simulator as its tests talk to it: through the hardware's interfaces only."""

from __future__ import annotations

from typing import Any

import numpy as np
from control_msgs.action import FollowJointTrajectory
from dgs_interfaces.msg import SimState
from dgs_interfaces.srv import InjectFault, SimReset
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64
from ur_dashboard_msgs.msg import SafetyMode

from dgs_description.joints import ARM_JOINTS, JointPath
from dgs_ros.action_client import SafeActionClient
from dgs_ros.joint_msgs import positions_of
from dgs_ros.trajectory_msgs import path_to_trajectory
from tests.support.processes import NodeProcess
from tests.support.ros_client import RosClient

ACTION = "/scaled_joint_trajectory_controller/follow_joint_trajectory"
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Bench:
    """A running simulator and a client of it."""

    def __init__(self, node: NodeProcess, client: RosClient, port: int) -> None:
        self.node, self.client, self.port = node, client, port
        self.action = SafeActionClient(client.node, FollowJointTrajectory, ACTION)

    def joints(self) -> np.ndarray:
        (message,) = self.client.collect(JointState, "/joint_states", 1)
        return positions_of(message, ARM_JOINTS)

    def state(self) -> SimState:
        (message,) = self.client.collect(SimState, "/sim/state", 1, qos=LATCHED)
        return message

    def reset(self, **request: Any) -> SimReset.Response:
        return self.client.call(SimReset, "/sim/reset", SimReset.Request(**request), timeout=20)

    def fault(self, fault: str, target: str = "", duration: float = 0.0) -> InjectFault.Response:
        request = InjectFault.Request(fault=fault, target=target, duration=duration)
        return self.client.call(InjectFault, "/sim/inject_fault", request)

    def status(self) -> tuple[bool, int, float]:
        """Whether the program runs, safety mode, speed scaling in percent."""
        io, collect = "/io_and_status_controller", self.client.collect
        (running,) = collect(Bool, f"{io}/robot_program_running", 1, qos=LATCHED)
        (mode,) = collect(SafetyMode, f"{io}/safety_mode", 1, qos=LATCHED)
        (scaling,) = collect(Float64, "/speed_scaling_state_broadcaster/speed_scaling", 1)
        return running.data, mode.mode, scaling.data

    def send(self, goal: FollowJointTrajectory.Goal, feedback: Any = None) -> Any:
        return self.client.wait(self.action.send_goal_async(goal, feedback_callback=feedback))

    def end(self, handle: Any) -> Any:
        assert handle.accepted
        return self.client.wait(handle.get_result_async(), 30)

    def run(self, goal: FollowJointTrajectory.Goal, feedback: Any = None) -> Any:
        return self.end(self.send(goal, feedback))


def move(
    start: np.ndarray, offset: float, duration: float = 0.8, names: Any = ARM_JOINTS
) -> FollowJointTrajectory.Goal:
    path = JointPath(
        np.array([0.0, duration]), np.stack([start, start + offset]), np.zeros((2, 6)), np.zeros((2, 6))
    )
    return FollowJointTrajectory.Goal(trajectory=path_to_trajectory(names, path))
