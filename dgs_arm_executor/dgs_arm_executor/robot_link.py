"""Arm and hand as the pick sequence sees them: motions over the action clients, every interruption watched."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any, Literal, Protocol

import numpy as np
from action_msgs.msg import GoalStatus
from control_msgs.action import FollowJointTrajectory
from dgs_interfaces.action import MoveHand
from numpy.typing import NDArray

from dgs_arm_executor.executor_msgs import payload_to_request, trajectory_to_goal
from dgs_arm_executor.executor_parameters import ArmExecutorParameters
from dgs_arm_executor.obstacle_cloud import ObstacleCloud
from dgs_arm_executor.remote import RemoteError, RemoteGoal, RemoteService
from dgs_arm_executor.safety import check_trajectory
from dgs_arm_executor.timing import Trajectory, anchored
from dgs_arm_executor.watch import HandReading, RobotWatch
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.joints import HAND_ACTIVE_JOINTS, reduce_to_active

Array = NDArray[np.float64]

_MODES = {"position": MoveHand.Goal.MODE_POSITION, "grasp": MoveHand.Goal.MODE_GRASP}
_FEEDBACK_PERIOD = 0.2
_STANDING = 0.003
"""An arm that is no farther from its start has not moved [rad]."""
_STOP_NEWS = 0.5
"""After an aborted trajectory the news of a protective stop may be so late [s]."""


class Station(Protocol):
    """What the link needs of the node."""

    parameters: ArmExecutorParameters
    watch: RobotWatch
    arm: RemoteGoal
    hand: RemoteGoal
    payload: RemoteService | None
    stopping: threading.Event

    def obstacle_cloud(self, arm_joints: Array, hand_joints: Array, fresh: bool) -> ObstacleCloud:
        """The newest cloud, without the robot; `fresh`: an old one or none at all is refused."""

    def get_clock(self) -> Any:
        """The node's ROS clock."""


class RobotLink:
    """`stages.Robot` over the node's clients, for one goal."""

    def __init__(self, node: Station, goal_handle: Any, feedback: Callable[[str, int, float], Any]):
        """`feedback` makes the goal's feedback message of stage, candidate and progress."""
        self._node, self._goal_handle, self._given = node, goal_handle, node.parameters
        self._feedback = feedback
        self._stage, self._candidate = "planning", -1

    def wait_until_ready(self) -> None:
        """Wait for the servers and for the first states. Raises DgsError."""
        end = time.monotonic() + self._given.ready_timeout
        while True:
            self._check_cancelled()
            missing = self._missing()
            if missing is None:
                return
            if time.monotonic() > end:
                raise missing
            time.sleep(0.05)

    def _missing(self) -> DgsError | None:
        try:
            self._node.watch.check_motion()
            self._node.watch.hand_joints()
        except DgsError as error:
            if error.code in (ErrorCode.STOPPED, ErrorCode.PROTECTIVE_STOP):
                raise
            return error
        if not self._node.arm.available():
            return DgsError(
                ErrorCode.CONTROLLER_UNAVAILABLE,
                f"nobody serves /{self._given.controller_name}/follow_joint_trajectory: start the arm's driver, check "
                "controller_name",
            )
        if self._node.payload is not None and not self._node.payload.available():
            return DgsError(
                ErrorCode.CONTROLLER_UNAVAILABLE,
                f"nobody serves {self._node.payload.name}: start the arm's driver, or set payload_service to ''",
            )
        if not self._node.hand.available():
            return DgsError(ErrorCode.HAND_UNAVAILABLE, "nobody serves /dexhand/move: start hand_driver_node")
        return None

    def arm_joints(self) -> Array:
        """(6,) measured just now [rad]."""
        return self._node.watch.arm_joints()

    def hand_joints(self) -> Array:
        """(20,) measured just now [rad]."""
        return self._node.watch.hand_joints()

    def hand_reading(self) -> HandReading:
        """Joints and torques measured just now."""
        return self._node.watch.hand_reading()

    def hand_at_rest(self) -> HandReading:
        """Joints and torques once no finger moves any more."""
        return self._node.watch.hand_at_rest()

    def observed_cloud(self, arm_joints: Array, hand_joints: Array, fresh: bool) -> ObstacleCloud:
        """The newest cloud, without the robot. Raises DgsError, see `Station.obstacle_cloud`."""
        return self._node.obstacle_cloud(arm_joints, hand_joints, fresh)

    def set_payload(self, holding: bool) -> None:
        """Tell the robot what it carries. Raises DgsError PAYLOAD_REFUSED."""
        if self._node.payload is None:
            return
        payload = self._given.payload(holding)
        try:
            taken = self._node.payload.call(payload_to_request(payload)).success
        except RemoteError as error:
            raise DgsError(ErrorCode.PAYLOAD_REFUSED, f"{self._node.payload.name}: {error}") from error
        if not taken:
            raise DgsError(
                ErrorCode.PAYLOAD_REFUSED,
                f"the robot refused a payload of {payload.mass:.2f} kg: check hand_mass and object_mass",
            )

    def enter(self, stage: str, candidate: int) -> None:
        """Publish that a stage begins."""
        self._stage, self._candidate = stage, candidate
        self._check()
        self._publish(0.0)

    def move_arm(self, trajectory: Trajectory, hand_joints: Array) -> None:
        """Check, send and watch one trajectory until its end. Raises DgsError."""
        self._check()
        measured = self._node.watch.arm_joints()
        off = float(np.abs(measured - trajectory.positions[0]).max())
        if off > self._given.start_tolerance:
            raise DgsError(
                ErrorCode.SAFETY_ENVELOPE,
                f"the arm is {off:.3f} rad away from where the motion was planned to start; nothing was sent",
            )
        motion = anchored(trajectory, measured)
        check_trajectory(
            motion.times, motion.positions, motion.velocities, measured, hand_joints, self._given.envelope()
        )
        goal = trajectory_to_goal(motion, self._given.goal_time_tolerance)
        try:
            answer = self._node.arm.run(goal, self._motion_watch(motion.duration))
        except RemoteError as error:
            raise DgsError(ErrorCode.TRAJECTORY_REJECTED, f"the arm's controller: {error}") from error
        if answer.status != GoalStatus.STATUS_SUCCEEDED:
            self._explain_abort(answer.result, measured)

    def move_hand(
        self, joints: Array, mode: Literal["position", "grasp"], uninterrupted: bool = False
    ) -> None:
        """Move the hand and wait for its end. Raises DgsError, also with the hand's own codes."""
        goal = MoveHand.Goal(
            joint_names=list(HAND_ACTIVE_JOINTS),
            positions=reduce_to_active(joints).tolist(),
            speed=self._given.hand_speed,
            mode=_MODES[mode],
        )

        def forward(msg: Any) -> None:
            self._publish(msg.feedback.progress)

        interrupted: Callable[[], None] = self._check_latch if uninterrupted else self._check

        def watch() -> None:
            interrupted()
            self._node.watch.hand_joints()  # a driver that has died sends no result

        try:
            answer = self._node.hand.run(goal, watch, forward)
        except RemoteError as error:
            raise DgsError(ErrorCode.HAND_UNAVAILABLE, f"the hand driver: {error}") from error
        if answer.status == GoalStatus.STATUS_UNKNOWN:
            raise DgsError(
                ErrorCode.HAND_UNAVAILABLE, "the hand driver knows nothing of the goal: it was restarted"
            )
        result = answer.result
        if result.error_code != ErrorCode.SUCCESS:
            watch()
            raise DgsError(ErrorCode(result.error_code), result.message)

    def _motion_watch(self, duration: float) -> Callable[[], None]:
        """Interruptions, feedback and the timeout of one motion; a robot that is slowed down gets more time."""
        now = self._node.get_clock().now
        limit = self._given.timeout_factor * duration + self._given.timeout_extra
        state = {"before": now(), "driven": 0.0, "told": time.monotonic()}

        def watch() -> None:
            self._check()
            time_now = now()
            passed = (time_now - state["before"]).nanoseconds * 1e-9
            state["driven"] += passed * self._node.watch.speed_scaling
            state["before"] = time_now
            if state["driven"] > limit:
                raise DgsError(
                    ErrorCode.TRAJECTORY_ABORTED,
                    f"the motion of {duration:.1f} s has not ended after {limit:.1f} s",
                )
            if time.monotonic() - state["told"] > _FEEDBACK_PERIOD:
                state["told"] = time.monotonic()
                self._publish(min(1.0, state["driven"] / duration))

        return watch

    def _explain_abort(self, result: FollowJointTrajectory.Result, start: Array) -> None:
        """Raise what an unsuccessful trajectory means; the robot's own stop is told a moment later."""
        end = time.monotonic() + _STOP_NEWS
        while time.monotonic() < end:
            self._check()
            time.sleep(0.02)
        # Some controllers accept a goal first and find it invalid then: an arm that has not moved tells the two apart.
        refusals = (FollowJointTrajectory.Result.INVALID_GOAL, FollowJointTrajectory.Result.INVALID_JOINTS)
        moved = float(np.abs(self.arm_joints() - start).max()) > _STANDING
        refused = result.error_code in refusals and not moved
        code = ErrorCode.TRAJECTORY_REJECTED if refused else ErrorCode.TRAJECTORY_ABORTED
        raise DgsError(
            code, f"the arm's controller ended the motion ({result.error_code}): {result.error_string}"
        )

    def _check(self) -> None:
        self._check_cancelled()
        self._node.watch.check_motion()

    def _check_latch(self) -> None:
        latched = self._node.watch.latched
        if latched is not None:
            raise latched

    def _check_cancelled(self) -> None:
        if self._goal_handle.is_cancel_requested:
            raise DgsError(ErrorCode.EXECUTION_CANCELLED, "cancelled on request")
        if self._node.stopping.is_set():
            raise DgsError(ErrorCode.EXECUTION_CANCELLED, "the node ends")

    def _publish(self, progress: float) -> None:
        if not self._node.stopping.is_set():
            self._goal_handle.publish_feedback(self._feedback(self._stage, self._candidate, float(progress)))
