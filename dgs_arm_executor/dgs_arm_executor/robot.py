"""Arm and hand as one goal sees them: how things stand, and motions that end or raise, every interruption watched."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np
from action_msgs.msg import GoalStatus
from control_msgs.action import FollowJointTrajectory
from dgs_interfaces.action import MoveHand
from numpy.typing import NDArray
from ur_msgs.srv import SetPayload

from dgs_arm_executor.executor_parameters import ArmExecutorParameters
from dgs_arm_executor.obstacle_cloud import ObstacleCloud
from dgs_arm_executor.remote import RemoteGoal, call_service
from dgs_arm_executor.safety import check_trajectory
from dgs_arm_executor.situation import ArmSituation, Load, payload
from dgs_arm_executor.timing import Trajectory, anchored
from dgs_arm_executor.watch import RobotWatch
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import Array
from dgs_description.hand import HAND
from dgs_description.joints import ARM_JOINTS, JointPath
from dgs_ros.pose_msgs import to_vector3
from dgs_ros.trajectory_msgs import path_to_trajectory, to_duration

_READY_TIMEOUT = 5.0
"""So long a goal waits for servers and first states [s]."""
_GOAL_TIME_TOLERANCE = 2.0
"""The controller may be late by so much [s]."""
_TIMEOUT_FACTOR, _TIMEOUT_EXTRA = 2.0, 4.0
"""A motion may take so many times its duration, and so much more [s]."""
_CLOCK_STEP = 1.0
"""More time does not pass between two looks at a motion: the clock was set [s]."""
_FEEDBACK_PERIOD = 0.2
_STANDING = 0.003
"""An arm that is no farther from its start has not moved, from its goal has arrived [rad]."""
_BRAKING = 1.0
"""An arm that was stopped comes to rest within that [s]."""
_STOP_NEWS = 0.5
"""After an aborted trajectory the news of a protective stop may be so late [s]."""
_ARRIVAL_NEWS = 2.0
"""After a trajectory's end the news of where the arm stands may be so late [s]: two topics know no order."""


class Robot:
    """Moves arm and hand over the node's clients, for one goal at a time. What interrupts a motion is raised.

    Attributes:
        watch: the robot's topics.
        arm, hand: action clients.
        cloud: obstacles as known when last looked at.
        load: what the hand holds, None = nothing; it outlives a goal.
        obstructed: something in the open hand kept it from its pre-grasp shape; likewise.
        candidate: index of the grasp in work, which feedback tells; -1 = none yet.
        out_of_view: whether the robot stays out of the camera's way until the goal's end, which feedback tells.
    """

    def __init__(
        self,
        given: ArmExecutorParameters,
        watch: RobotWatch,
        arm: RemoteGoal,
        hand: RemoteGoal,
        payload_client: Any,
        see: Callable[[bool], ObstacleCloud],
    ):
        """Take the node's parts.

        Args:
            payload_client: of SetPayload; None = the robot is not told what it carries.
            see: the newest cloud without the robot; True: an old one or none at all is refused.
        """
        self._given, self.watch, self.arm, self.hand = given, watch, arm, hand
        self._payload_client, self._see = payload_client, see
        self.cloud = ObstacleCloud()
        self.load: Load | None = None
        self.obstructed = False
        self.candidate, self.out_of_view = -1, False
        self._stop_before = watch.stop

    def begin(self, cancelled: Callable[[], str], feedback: Callable[[str, int, float, bool], None]) -> None:
        """Serve a goal, once the servers are there and the first states have come.

        Args:
            cancelled: why the goal shall end; "" = it goes on.
            feedback: publishes stage, candidate, progress and whether the robot is out of the camera's way.

        Raises:
            DgsError: JOINT_STATES_SILENT, STOPPED, PROTECTIVE_STOP, EXECUTION_CANCELLED, CONTROLLER_UNAVAILABLE,
                HAND_UNAVAILABLE; SAFETY_ENVELOPE if the arm does not come to rest.
        """
        self._cancelled, self._feedback = cancelled, feedback
        self._stage, self.candidate, self.out_of_view = "planning", -1, False
        self._stop_before = self.watch.stop
        end = time.monotonic() + _READY_TIMEOUT
        while (missing := self._missing()) is not None:
            if time.monotonic() > end:
                raise missing
            time.sleep(0.01)

    def enter(self, stage: str) -> None:
        """Publish that a stage begins."""
        self._stage = stage
        self._check()
        self._tell(0.0)

    def situation(self) -> ArmSituation:
        """How things stand now, the cloud as last looked at."""
        return replace(self.watch.situation(), cloud=self.cloud, load=self.load)

    def look(self, fresh: bool) -> ArmSituation:
        """How things stand now; `fresh`: an old cloud or none at all is refused."""
        self.cloud = self._see(fresh)
        return self.situation()

    def set_payload(self, holding: bool) -> None:
        """Tell the robot what it carries: the hand alone, or with an object. Raises DgsError PAYLOAD_REFUSED."""
        if self._payload_client is None:
            return
        given, held = self._given, self._given.object_mass if holding else 0.0
        mass, centre = payload(given.hand_mass, given.hand_centre_of_mass, held)
        request = SetPayload.Request(mass=mass, center_of_gravity=to_vector3(centre))
        if not call_service(self._payload_client, request, ErrorCode.PAYLOAD_REFUSED).success:
            cure = "check hand_mass and object_mass, and the driver's log"
            refused = f"the robot refused a payload of {mass:.2f} kg: {cure}"
            raise DgsError(ErrorCode.PAYLOAD_REFUSED, refused)

    def move_arm(
        self,
        trajectory: Trajectory,
        *hand_shapes: Array,
        clear_from: float = np.inf,
        meanwhile: Callable[[], None] = lambda: None,
    ) -> None:
        """Check, send and watch one trajectory until its end.

        Args:
            trajectory: from where the arm stands.
            hand_shapes: (J,) joints that the hand has on the way [rad].
            clear_from: time of the trajectory after which feedback says that the robot is out of the camera's way [s].
            meanwhile: asked again and again; what it raises ends the motion.

        Raises:
            DgsError: SAFETY_ENVELOPE, and whatever interrupts or ends it.
        """
        motion = self._checked(trajectory, hand_shapes)
        message = path_to_trajectory(ARM_JOINTS, JointPath(**vars(motion)))
        tolerance = to_duration(_GOAL_TIME_TOLERANCE)
        goal = FollowJointTrajectory.Goal(trajectory=message, goal_time_tolerance=tolerance)
        watch = self._motion_watch(motion, clear_from, meanwhile)
        try:
            answer = self.arm.run(goal, watch)
        except DgsError:
            self._await(_BRAKING, self.watch.arm_stands)  # what comes next is planned from where it stands
            raise
        if answer.status != GoalStatus.STATUS_SUCCEEDED:
            self._explain_abort(answer.result, motion.positions[0])
        self._await(_ARRIVAL_NEWS, lambda: self._arrived(motion.positions[-1]))
        if clear_from <= motion.duration:
            self._clear()

    def move_both(self, trajectory: Trajectory, hand_joints: Array) -> None:
        """Drive one trajectory while the hand goes to (J,) joints [rad]; what ends one of them ends the other."""
        before = self.situation().hand_joints
        with ThreadPoolExecutor(1) as pool:
            shaping = pool.submit(self.move_hand, hand_joints, quiet=True)

            def watch() -> None:
                if shaping.done():
                    shaping.result()

            try:
                self.move_arm(trajectory, before, hand_joints, meanwhile=watch)
            except BaseException:
                while not shaping.done():  # its goal may only now be on its way
                    self.hand.cancel()
                    wait([shaping], 0.05)
                raise
            shaping.result()

    def move_hand(
        self,
        joints: Array,
        closing: NDArray[np.bool_] | None = None,
        uninterrupted: bool = False,
        quiet: bool = False,
    ) -> None:
        """Bring the hand to (J,) joints [rad], and wait for its end.

        Args:
            closing: (F,) fingers that go towards them under admittance control, until contact; None = to them.
            uninterrupted: also after a cancel, and while the arm is silent.
            quiet: without feedback of its progress.

        Raises:
            DgsError: also with the hand's own codes.
        """
        goal = MoveHand.Goal(
            joint_names=list(HAND.driven_joints),
            positions=HAND.reduce(joints).tolist(),
            speed=self._given.shaping_speed if closing is None else 0.0,
            mode=MoveHand.Goal.MODE_POSITION if closing is None else MoveHand.Goal.MODE_GRASP,
            active_fingers=[] if closing is None else closing.tolist(),
        )

        def watch() -> None:
            if not uninterrupted:
                return self._check()
            self._check_stopped()
            self.watch.check_hand()

        tell = None if quiet else lambda message: self._tell(message.feedback.progress)
        answer = self.hand.run(goal, watch, tell)
        if answer.status == GoalStatus.STATUS_UNKNOWN:
            restarted = "the hand driver knows nothing of the goal: it was restarted"
            raise DgsError(ErrorCode.HAND_UNAVAILABLE, restarted)
        if answer.result.error_code != ErrorCode.SUCCESS:
            watch()
            raise DgsError(ErrorCode(answer.result.error_code), answer.result.message)

    def open_hand(self, opened: Array = HAND.open_hand) -> DgsError | None:
        """Open the hand even if somebody cancels meanwhile; the hand's own fault is returned, others are raised."""
        try:
            self.move_hand(opened, uninterrupted=True)
        except DgsError as error:
            if not is_hand_fault(error):
                raise
            return error
        return None

    def _checked(self, trajectory: Trajectory, hand_shapes: Sequence[Array]) -> Trajectory:
        """The trajectory from where the arm is measured. Raises DgsError SAFETY_ENVELOPE where it may not be sent."""
        measured = self.watch.arm_joints()
        off = float(np.abs(measured - trajectory.positions[0]).max())
        if off > self._given.start_tolerance:
            astray = f"the arm is {off:.3f} rad away from where the motion was planned to start"
            raise DgsError(ErrorCode.SAFETY_ENVELOPE, f"{astray}; nothing was sent")
        motion = anchored(trajectory, measured)
        for shape in hand_shapes:
            check_trajectory(motion.times, motion.positions, motion.velocities, measured, shape, self._given)
        return motion

    def _missing(self) -> DgsError | None:
        """What a goal still waits for; what waiting does not help against is raised."""
        self._check_cancelled()
        try:
            self.watch.check_motion()
            self.watch.check_hand()
        except DgsError as error:
            if error.code in (ErrorCode.STOPPED, ErrorCode.PROTECTIVE_STOP):
                raise
            return error
        if not self.watch.arm_stands():
            return DgsError(ErrorCode.SAFETY_ENVELOPE, "the arm is not at rest, though no goal moves it")
        if not self.arm.available():
            action = f"/{self._given.controller_name}/follow_joint_trajectory"
            cure = f"nobody serves {action}: start the arm's driver, check controller_name"
            return DgsError(ErrorCode.CONTROLLER_UNAVAILABLE, cure)
        client = self._payload_client
        if client is not None and not client.service_is_ready():
            cure = f"nobody serves {client.srv_name}: start the arm's driver, or set payload_service to ''"
            return DgsError(ErrorCode.CONTROLLER_UNAVAILABLE, cure)
        if not self.hand.available():
            return DgsError(ErrorCode.HAND_UNAVAILABLE, "nobody serves /dexhand/move: start hand_driver_node")
        return None

    def _motion_watch(
        self, motion: Trajectory, clear_from: float, meanwhile: Callable[[], None]
    ) -> Callable[[], None]:
        """Interruptions, feedback and the timeout of one motion; a robot that is slowed down gets more time."""
        limit = _TIMEOUT_FACTOR * motion.duration + _TIMEOUT_EXTRA
        before, driven, told = self.watch.now(), 0.0, time.monotonic()
        set_off = np.inf  # it moves since

        def watch() -> None:
            nonlocal before, driven, told, set_off
            self._check()
            meanwhile()
            now = self.watch.now()
            passed = float(np.clip(now - before, 0.0, _CLOCK_STEP))
            driven, before = driven + passed * self.watch.speed_scaling, now
            if driven > limit:
                late = f"the motion of {motion.duration:.1f} s has not ended after {limit:.1f} s"
                raise DgsError(ErrorCode.TRAJECTORY_ABORTED, late)
            if set_off == np.inf and self._moved(motion.positions[0]):
                set_off = driven
            if driven - set_off > clear_from and not self.out_of_view:
                self._clear()
            if time.monotonic() - told > _FEEDBACK_PERIOD:
                told = time.monotonic()
                self._tell(min(1.0, driven / motion.duration))

        return watch

    def _await(self, timeout: float, condition: Callable[[], bool]) -> None:
        """Until it holds, the time [s] is over, or nothing is heard of the arm."""
        end = time.monotonic() + timeout
        with suppress(DgsError):
            while not condition() and time.monotonic() < end:
                self.watch.arm_joints()
                time.sleep(0.005)

    def _arrived(self, joints: Array) -> bool:
        """Whether the arm is measured at (6,) joints [rad], or stands where its controller takes that for them."""
        off = float(np.abs(self.watch.arm_joints() - joints).max())
        return off < _STANDING or (off < self._given.start_tolerance and self.watch.arm_stands())

    def _explain_abort(self, result: FollowJointTrajectory.Result, start: Array) -> None:
        """Raise what an unsuccessful trajectory means; the robot's own stop is told a moment later."""
        end = time.monotonic() + _STOP_NEWS
        while time.monotonic() < end:
            self._check()
            time.sleep(0.02)
        # Some controllers accept a goal first and find it invalid then: an arm that has not moved tells the two apart.
        refusals = (FollowJointTrajectory.Result.INVALID_GOAL, FollowJointTrajectory.Result.INVALID_JOINTS)
        refused = result.error_code in refusals and not self._moved(start)
        code = ErrorCode.TRAJECTORY_REJECTED if refused else ErrorCode.TRAJECTORY_ABORTED
        if result.error_code == FollowJointTrajectory.Result.PATH_TOLERANCE_VIOLATED:
            self.watch.force.pushed_off()
        ended = f"the arm's controller ended the motion ({result.error_code})"
        raise DgsError(code, f"{ended}: {result.error_string}")

    def _moved(self, start: Array) -> bool:
        return float(np.abs(self.watch.arm_joints() - start).max()) > _STANDING

    def _clear(self) -> None:
        self.out_of_view = True
        self._tell(1.0)

    def _tell(self, progress: float) -> None:
        self._feedback(self._stage, self.candidate, progress, self.out_of_view)

    def _check(self) -> None:
        self._check_cancelled()
        self.watch.check_motion()
        self._check_stopped()
        self.watch.check_hand()  # a driver that has died sends no result, and what its hand does nobody knows
        self.arm.check()
        self.hand.check()

    def _check_stopped(self) -> None:
        """A stop ends the goal even if nobody looked before motion was allowed again."""
        stop = self.watch.stop
        if stop is not None and stop is not self._stop_before:
            raise DgsError(stop.code, stop.message)

    def _check_cancelled(self) -> None:
        why = self._cancelled()
        if why:
            raise DgsError(ErrorCode.EXECUTION_CANCELLED, why)


def is_hand_fault(error: DgsError) -> bool:
    """Whether the hand itself has failed, not somebody who interrupted it."""
    return 300 <= int(error.code) < 400
