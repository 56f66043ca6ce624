import threading
from types import SimpleNamespace
from typing import Any

import numpy as np
from control_msgs.action import FollowJointTrajectory

from dgs_description.joints import ARM_JOINTS, JointPath
from dgs_ros.trajectory_msgs import path_to_trajectory, to_time
from dgs_sim_bridge.sim_bridge_node import SimBridgeNode
from dgs_sim_bridge.world.arm_controller import ArmGoal, Outcome
from dgs_sim_bridge.world.trajectory import FollowCode


def test_a_goal_whose_end_has_passed_since_it_was_accepted_is_begun() -> None:
    """A busy machine takes its time between the two."""
    begun, end = [], Outcome("succeeded", FollowCode.SUCCESSFUL, "")

    def start(goal: ArmGoal) -> None:
        begun.append(goal)
        goal.on_end(end)

    wanted = path_to_trajectory(ARM_JOINTS, JointPath(np.array([0.0, 2.0]), np.zeros((2, 6))))
    wanted.header.stamp = to_time(7.0)
    handle = SimpleNamespace(request=FollowJointTrajectory.Goal(trajectory=wanted), is_cancel_requested=False)
    node: Any = SimpleNamespace(
        _simulation=SimpleNamespace(time=9.1, start_goal=start),
        stopping=threading.Event(),
        _finish=lambda _, outcome: outcome,
    )
    execute: Any = SimBridgeNode._execute
    assert execute(node, handle) == end
    assert begun[0].start_time == 7.0
