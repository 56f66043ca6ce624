"""The arm executor with the real hand driver and the simulated arm, as a test talks to them."""

from __future__ import annotations

import threading
from typing import Any

import numpy as np
from dgs_interfaces.action import ExecuteGrasp, GoHome
from dgs_interfaces.msg import Grasp, SimState
from dgs_interfaces.srv import InjectFault, SimReset
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from sensor_msgs.msg import JointState, PointCloud2
from std_msgs.msg import Header
from std_srvs.srv import Trigger

from dgs_description.frames import BASE_LINK
from dgs_description.hand import HAND
from dgs_description.joints import ARM_JOINTS
from dgs_ros.action_client import SafeActionClient
from dgs_ros.cloud_msgs import numpy_to_cloud
from dgs_ros.grasp_msgs import grasps_to_msgs
from dgs_ros.joint_msgs import positions_of
from tests.support.environment import GUARD, wait_until
from tests.support.grasps import top_grasps
from tests.support.processes import NodeProcess
from tests.support.ros_client import RosClient

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
FIST = np.tile([0.0, 0.75, 0.6, 0.6], 5)
"""Final joints of a power grasp that any object of a few centimetres stops on the way."""
TABLE = np.array([(x, y, -0.2) for x in np.arange(0.1, 0.5, 0.008) for y in np.arange(-0.4, 0.4, 0.008)])
"""What a camera sees of the empty table in the workspace [m]."""


class Cell:
    """Simulator, hand driver and arm executor, and a client that talks to them."""

    def __init__(self, executor: NodeProcess, sim: NodeProcess, client: RosClient) -> None:
        self.executor, self.sim, self.client = executor, sim, client
        self.action = SafeActionClient(client.node, ExecuteGrasp, "/execute_grasp")
        self.home = SafeActionClient(client.node, GoHome, "/go_home")
        self.cloud = numpy_to_cloud(TABLE, BASE_LINK)
        self.clouds = client.node.create_publisher(PointCloud2, "/dgs/cloud", qos_profile_sensor_data)
        self.camera_works = True
        client.node.create_timer(0.1, lambda: self.camera_works and self.clouds.publish(self.cloud))

    def arm(self) -> np.ndarray:
        (message,) = self.client.collect(JointState, "/joint_states", 1)
        return positions_of(message, ARM_JOINTS)

    def arm_at_rest(self) -> np.ndarray:
        """The arm's joints once it has braked; a stop takes some tenths of a second."""
        states: list[JointState] = []

        def resting() -> bool:
            states.extend(self.client.collect(JointState, "/joint_states", 1))
            return np.abs(states[-1].velocity).max() < 1e-3

        self.sim.wait_ready(resting, timeout=5.0)
        return positions_of(states[-1], ARM_JOINTS)

    def hand(self) -> np.ndarray:
        (message,) = self.client.collect(JointState, "/dexhand/joint_states", 1)
        return positions_of(message, HAND.joints)

    def objects(self) -> SimState:
        # The first message is the latched one, which may be older than what was done last.
        return self.client.collect(SimState, "/sim/state", 2, qos=LATCHED)[-1]

    def reset_scene(self, objects: int, seed: int = 0, catalogue: str = "") -> None:
        wish = SimReset.Request(objects=objects, seed=seed, catalogue=catalogue)
        answer = self.client.call(SimReset, "/sim/reset", wish, timeout=20)
        assert answer.error_code == 0, answer.message

    def fault(self, fault: str, duration: float = 0.0) -> None:
        answer = self.client.call(
            InjectFault, "/sim/inject_fault", InjectFault.Request(fault=fault, duration=duration)
        )
        assert answer.error_code == 0, answer.message

    def go_home(self) -> GoHome.Result:
        handle = self.client.wait(self.home.send_goal_async(GoHome.Goal()))
        return self.client.wait(handle.get_result_async(), 120).result

    def trigger(self, name: str) -> Trigger.Response:
        return self.client.call(Trigger, name, Trigger.Request())

    def show_cloud(self, points: np.ndarray) -> None:
        """Let the executor see the table with these points from now on, ten times a second as from a camera."""
        self.cloud = numpy_to_cloud(np.concatenate([TABLE, points]), BASE_LINK)
        self.clouds.publish(self.cloud)

    def pick(self, grasps: list[Grasp], **goal: Any) -> tuple[int, ExecuteGrasp.Result, list[str]]:
        """Send a goal, wait for its end: status, result, stages in order."""
        run = self.start(grasps, **goal)
        return run.end()

    def start(self, grasps: list[Grasp], frame: str = BASE_LINK, cancel_at: str = "", **goal: Any) -> Run:
        """Send a goal; `cancel_at`: cancel it as soon as it says that this stage has begun."""
        return Run(self, ExecuteGrasp.Goal(header=Header(frame_id=frame), grasps=grasps, **goal), cancel_at)


class Run:
    """A goal under way."""

    def __init__(self, cell: Cell, goal: ExecuteGrasp.Goal, cancel_at: str = "") -> None:
        self._cell = cell
        self._cancel_at = cancel_at
        self.stages: list[str] = []
        self.out_of_view = False
        self._news = threading.Condition()
        with self._news:  # news of a stage may come before the answer that the goal is accepted
            self._sent = cell.action.send_goal_async(goal, feedback_callback=self._note)
        self._handle = cell.client.wait(self._sent)
        self._result = self._handle.get_result_async()

    def _note(self, message: Any) -> None:
        with self._news:
            if not self.stages or self.stages[-1] != message.feedback.stage:
                self.stages.append(message.feedback.stage)
                if message.feedback.stage == self._cancel_at:
                    self._cell.action.cancel_when_accepted(self._sent)
            self.out_of_view |= message.feedback.out_of_view
            self._news.notify_all()

    def wait_for(self, stage: str, timeout: float = GUARD) -> None:
        wait_until(lambda: stage in self.stages or self.done(), timeout)
        assert stage in self.stages or (self.end() and stage in self.stages), (
            self.stages,
            self.end()[1].message,
        )

    def cancel(self) -> None:
        self._cell.client.wait(self._handle.cancel_goal_async())

    def done(self) -> bool:
        return self._result.done()

    def end(self) -> tuple[int, ExecuteGrasp.Result, list[str]]:
        answer = self._cell.client.wait(self._result, 150)
        done = {stage.stage for stage in answer.result.stage_times}
        with self._news:  # the last words before the result may be heard after it
            self._news.wait_for(lambda: done <= set(self.stages), 10.0)
        return answer.status, answer.result, self.stages


def top_grasp(x: float, y: float, z: float, yaw: float = 0.0, final: np.ndarray = FIST) -> Grasp:
    """A grasp from above with the TCP at a place in `base_link` [m]."""
    return grasps_to_msgs(top_grasps(np.array([x, y, z]), yaw=yaw, final=final))[0]
