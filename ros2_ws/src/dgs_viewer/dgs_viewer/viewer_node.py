"""The live page's node: topics into the page's state, buttons into goals and calls.

Nobody wakes up for messages that come often: ten times a second they are taken all at once, and the newest is read;
of clouds and pictures, which cost most, fewer. While nobody looks, there is no subscription to those and nothing is
drawn; the rest is remembered.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from action_msgs.msg import GoalStatus, GoalStatusArray
from dgs_interfaces.action import ClearTable, ExecuteGrasp
from dgs_interfaces.msg import GraspArray, PickPlan, TargetRegion
from dgs_interfaces.srv import SimReset
from diagnostic_msgs.msg import DiagnosticArray
from numpy.typing import NDArray
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.qos import QoSProfile, qos_profile_sensor_data
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription
from sensor_msgs.msg import CameraInfo, Image, JointState, PointCloud2
from std_srvs.srv import Trigger

from dgs_description.camera import PinholeCamera
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import BASE_LINK, apply, transform
from dgs_description.hand import HAND
from dgs_description.joints import ARM_JOINTS
from dgs_description.parameters import parameter
from dgs_description.words import plural
from dgs_ros.action_client import SafeActionClient
from dgs_ros.base_node import LATCHED, DgsNode
from dgs_ros.cloud_msgs import cloud_to_numpy
from dgs_ros.diagnostics import Level
from dgs_ros.grasp_msgs import grasps_from_msgs
from dgs_ros.image_msgs import camera_info_to_pinhole, colour_to_numpy
from dgs_ros.joint_msgs import has_joints, positions_of
from dgs_ros.pose_msgs import matrix_to_pose, to_vector3
from dgs_ros.presence import Watch, watch_server
from dgs_ros.run import run
from dgs_ros.static_frames import StaticFrames
from dgs_ros.trajectory_msgs import trajectory_to_path
from dgs_viewer.colours import make_cloud
from dgs_viewer.gate import Gate
from dgs_viewer.page import Page
from dgs_viewer.pointing import Box
from dgs_viewer.state import Offer, RateMeter, ViewerState

PERIOD = 0.1
"""The page is brought up to date so often [s]."""
CLOUD_PERIOD = 0.3
"""A cloud is read so often while somebody looks at the page [s]."""
_RATED = ("arm", "hand", "cloud")
"""Whose rates are shown."""
NICENESS = 10
"""The picks come first."""
_AS_WISHED = (ErrorCode.SUCCESS, ErrorCode.TASK_ATTEMPTS_USED_UP)
"""A single pick ends with the second."""


@dataclass(frozen=True)
class ViewerParameters:
    """See the descriptions."""

    host: str = parameter("127.0.0.1", "Address to listen on; off loopback visitors need the token.")
    port: int = parameter(8080, "Port of the page; if it is in use, one of the next nine. 0 = any.", 0, 65535)
    token: str = parameter("", "What visitors bring as ?token=; empty = none on loopback, else a random one.")
    cloud_topic: str = parameter("/dgs/cloud", "Clouds of the camera node.")
    colour_topic: str = parameter(
        "/camera/camera/color/image_raw", "Picture that colours the cloud; empty = none.", optional=True
    )
    colour_info_topic: str = parameter(
        "/camera/camera/depth/camera_info", "Intrinsics of that picture (the simulated one has the depth's)."
    )
    simulated: bool = parameter(True, "Whether there is a simulated scene that can be changed.")
    seed: int = parameter(0, "Seed of the runs started from the page.", 0)


class PolledGroup(ReentrantCallbackGroup):
    """Of subscriptions that no executor looks at: the middleware keeps their messages until somebody takes them."""

    def can_execute(self, entity: Any) -> bool:
        """Never."""
        return False


class ViewerNode(DgsNode[ViewerParameters]):
    """Feeds the page, and is its `Commands`."""

    def __init__(self, **node_arguments: Any) -> None:
        """Serve the page. Raises DgsError PARAMETER_INVALID: no port is free."""
        super().__init__("viewer_node", ViewerParameters, **node_arguments)
        given = self.parameters
        self._state, self._rates, self._frames = ViewerState(), RateMeter(), StaticFrames(self)
        self._polled: dict[str, Subscription] = {}
        self._newest: dict[str, bytes] = {}
        self._wrong: dict[str, str] = {}
        self._at_work: dict[str, Watch] = {}
        """Actions that have goals in work, and who serves them."""
        self._cloud_read = 0.0
        self._camera: PinholeCamera | None = None
        self._camera_frame = ""
        self._picture: tuple[NDArray[np.uint8], str] | None = None
        group = ReentrantCallbackGroup()
        self._task = SafeActionClient(self, ClearTable, "/clear_table", callback_group=group)
        self._stop, self._reset = (
            self.create_client(Trigger, name, callback_group=group) for name in ("/stop", "/reset")
        )
        self._sim = self.create_client(SimReset, "/sim/reset", callback_group=group)
        self._page = Page(self._state, self, given.simulated)
        try:
            self._gate = Gate(given.host, given.port, self._page.address, given.token)
        except DgsError:
            self._page.close()
            raise
        self._subscribe()
        self.every(PERIOD, self._update)
        self.report(Level.OK, f"page at {self._gate.address.partition('?')[0]}")
        self.get_logger().info(f"live page: {self._gate.address}")

    def close(self) -> None:
        """End the page."""
        self._gate.close()
        self._page.close()

    # topics

    def _subscribe(self) -> None:
        states = QoSProfile(depth=50)
        self._poll(JointState, "/joint_states", "arm", states)
        self._poll(JointState, "/dexhand/joint_states", "hand", states)
        for kind, topic, callback, qos in (
            (GraspArray, "/dgs/grasps", self._on_grasps, LATCHED),
            (PickPlan, "/dgs/pick_plan", self._on_plan, LATCHED),
            (DiagnosticArray, "/diagnostics", self._on_diagnostics, 50),
            # What an action's clients are told is a topic like any other.
            (ClearTable.Impl.FeedbackMessage, "/clear_table/_action/feedback", self._on_task, 50),
            (ExecuteGrasp.Impl.FeedbackMessage, "/execute_grasp/_action/feedback", self._on_arm, 50),
        ):
            self.create_subscription(kind, topic, self._guarded(topic, callback), qos)
        for action in ("/clear_table", "/execute_grasp"):
            on_goals = partial(self._on_goals, action)
            self.create_subscription(GoalStatusArray, f"{action}/_action/status", on_goals, LATCHED)

    def _watch(self, seen: bool) -> None:
        """Subscribe to what the camera sees, or no longer."""
        given, sensor = self.parameters, qos_profile_sensor_data
        if seen:
            self._poll(PointCloud2, given.cloud_topic, "cloud", sensor)
            if given.colour_topic:
                self._poll(Image, given.colour_topic, "picture", sensor)
                self._poll(CameraInfo, given.colour_info_topic, "camera", sensor)
            return
        for name in self._polled.keys() - {"arm", "hand"}:
            self.destroy_subscription(self._polled.pop(name))
            self._newest.pop(name, None)
        self._picture = None  # of what will have changed when somebody looks again
        self._state.put(cloud=None)

    def _poll(self, kind: Any, topic: str, name: str, qos: QoSProfile) -> None:
        """Subscribe to what `_take_all` takes."""
        group = PolledGroup()
        self._polled[name] = self.create_subscription(
            kind, topic, lambda _: None, qos, raw=True, callback_group=group
        )

    def _take_all(self) -> None:
        """Take what has come since the last call, and keep the newest of each."""
        for name, subscription in self._polled.items():
            with subscription.handle:
                while (taken := subscription.handle.take_message(subscription.msg_type, True)) is not None:
                    self._newest[name] = taken[0]
                    if name in _RATED:
                        self._rates.count(name)

    def _guarded(self, topic: str, callback: Callable[[Any], None]) -> Callable[[Any], None]:
        """A message that makes no sense is logged on the page; the next one of the topic only if it says otherwise."""

        def take(message: Any) -> None:
            try:
                callback(message)
                self._wrong.pop(topic, None)
            except DgsError as error:
                if self._wrong.get(topic) != error.message:
                    self._log(f"{topic}: {error.message}", Level.WARN, error.code)
                self._wrong[topic] = error.message

        return take

    def _on_grasps(self, message: GraspArray) -> None:
        self._state.put(offer=Offer(grasps_from_msgs(message.grasps)))

    def _on_plan(self, message: PickPlan) -> None:
        refusals = {each.index: (each.code, each.reason) for each in message.rejections}
        ways = [trajectory_to_path(motion, ARM_JOINTS).positions for motion in message.motions]
        motions = tuple(zip(message.stages, ways, strict=True))
        self._state.put(offer=Offer(grasps_from_msgs(message.grasps), message.chosen, refusals, motions))

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            code = next((value.value for value in status.values if value.key == "code"), "0")
            number = int(code) if code.isdigit() else 0
            level = Level.OK if number in _AS_WISHED[1:] else status.level[0]
            self._state.report(time.time(), status.name, int(level), number, status.message)

    def _on_task(self, message: Any) -> None:
        told = message.feedback
        # With an action's name the arm's stage is passed on, which is no sentence.
        said = {} if told.message.startswith("/") else {"sentence": told.message}
        self._state.put(stage=told.stage, counts=(told.attempts, told.successes), **said)
        if told.stage in ("predicted", "recorded", "rejected"):
            self._log(told.message)

    def _on_arm(self, message: Any) -> None:
        self._state.put(stage=message.feedback.stage)

    def _on_goals(self, action: str, message: GoalStatusArray) -> None:
        """Note whether an action has goals in work, whoever sent them."""
        if any(each.status < GoalStatus.STATUS_SUCCEEDED for each in message.status_list):
            self._at_work.setdefault(action, watch_server(self, action))
        elif message.status_list:
            self._ended(action)

    def _ended(self, action: str) -> None:
        """When the last goal of all has ended nothing is done any more."""
        self._at_work.pop(action, None)
        if not self._at_work:
            self._state.put(stage="idle")

    # the page

    def _update(self) -> None:
        now, steady, seen = time.time(), time.monotonic(), self._page.seen
        for action in [action for action, server in list(self._at_work.items()) if server.lost()]:
            self._log(f"who serves {action} has gone in the middle of it", Level.ERROR)
            self._ended(action)
        if seen != ("cloud" in self._polled):
            self._watch(seen)
        self._take_all()
        self._read("arm", self._read_arm)
        self._read("hand", self._read_hand)
        if steady - self._cloud_read > CLOUD_PERIOD:
            self._cloud_read = steady
            self._read("camera", self._read_camera)
            self._read("picture", self._read_picture)
            self._read("cloud", self._read_cloud)
        self._rates.update(steady)
        sample = self._state.tick(now)
        if seen:
            self._page.update(sample, self._rates.rates)

    def _read(self, name: str, read: Callable[[Any], None]) -> None:
        """Read the newest message, if one has come since the last call."""
        newest = self._newest.pop(name, None)
        if newest is not None:
            self._guarded(name, read)(deserialize_message(newest, self._polled[name].msg_type))

    def _read_arm(self, message: JointState) -> None:
        if has_joints(message, ARM_JOINTS):
            self._state.put(arm=positions_of(message, ARM_JOINTS))

    def _read_hand(self, message: JointState) -> None:
        self._state.put(hand=positions_of(message, HAND.joints))

    def _read_camera(self, message: CameraInfo) -> None:
        self._camera, self._camera_frame = camera_info_to_pinhole(message), message.header.frame_id

    def _read_picture(self, message: Image) -> None:
        pixels, frame, camera = colour_to_numpy(message), message.header.frame_id, self._camera
        self._picture = pixels, frame
        if camera is None:
            return
        told = camera.height, camera.width, self._camera_frame
        if (*pixels.shape[:2], frame) != told:
            self._picture = None  # points would get colours of other places
            picture, info = (f"{w} x {h} pixels in {of!r}" for h, w, of in ((*pixels.shape[:2], frame), told))
            wrong = f"the picture has {picture}, the camera info {info}: set colour_info_topic"
            raise DgsError(ErrorCode.CAMERA_INFO_INVALID, wrong)

    def _read_cloud(self, message: PointCloud2) -> None:
        T_base_cloud = self._frames.pose(message.header.frame_id)
        if T_base_cloud is None:
            unknown = f"the cloud's frame {message.header.frame_id!r} is unknown: is it on /tf_static?"
            raise DgsError(ErrorCode.CLOUD_FRAME_UNKNOWN, unknown)
        points = apply(T_base_cloud, cloud_to_numpy(message).astype(np.float64))
        picture, frame = self._picture or (None, "")
        self._state.put(cloud=make_cloud(points, picture, self._camera, self._frames.pose(frame)))

    # Commands

    def stop(self) -> None:
        """Stop arm and hand; a run ends with it, whoever started it."""
        self._call(self._stop, Trigger.Request(), "stop")

    def reset(self) -> None:
        """Allow motion again after a stop."""
        self._call(self._reset, Trigger.Request(), "reset")

    def new_scene(self, seed: int, objects: int) -> None:
        """Put other objects onto the simulated table."""
        self._call(self._sim, SimReset.Request(seed=seed, objects=objects), "another scene")

    def clear(self, attempts: int, target: Box | None) -> None:
        """Clear the table, or what lies in a box; 0 attempts = as many as it takes."""
        if not self._task.server_is_ready():
            self._log("nobody serves /clear_table: start clear_table", Level.ERROR)
            return
        goal = ClearTable.Goal(max_attempts=attempts, seed=self.parameters.seed)
        if target is not None:
            goal.target_region = _region(target)
        self._log("asked for " + ("one pick" if attempts == 1 else "a cleared table"))
        self._task.send_goal_async(goal).add_done_callback(partial(self._on_accepted, target))

    def _on_accepted(self, target: Box | None, future: Any) -> None:
        handle = future.result()
        if not handle.accepted:
            self._log("/clear_table refused the goal; its log says why", Level.ERROR)
            return

        def finish(ended: Any) -> None:
            if ended.result().status == GoalStatus.STATUS_UNKNOWN:
                self._log("/clear_table does not know the run: it was started anew meanwhile", Level.ERROR)
                return
            result = ended.result().result
            level = Level.OK if result.error_code in _AS_WISHED else Level.WARN
            if result.error_code == ErrorCode.TASK_BUSY:
                self._log(result.message, level, result.error_code)
                return
            done = f"{result.successes} of {plural(result.attempts, 'grasp')} succeeded"
            done += f", {plural(result.pushes, 'push')}" if result.pushes else ""
            told = result.message if done in result.message else f"{result.message}; {done}"
            self._log(f"run ended: {told}", level, result.error_code)
            self._state.put(sentence=told)
            if result.successes:
                self._page.forget_target(target)

        handle.get_result_async().add_done_callback(finish)

    def _call(self, client: Any, request: Any, what: str) -> None:
        """Ask a service; its answer is logged."""
        if not client.service_is_ready():
            self._log(f"{what}: nobody serves {client.srv_name}", Level.ERROR)
            return

        def told(future: Any) -> None:
            answer = future.result()
            code = getattr(answer, "error_code", 0)
            well = code == 0 and getattr(answer, "success", True)
            self._log(f"{what}: {answer.message}", Level.OK if well else Level.ERROR, code)
            if client is self._sim and well:  # what was predicted lay there before
                self._state.put(offer=None)

        client.call_async(request).add_done_callback(told)

    def _log(self, text: str, level: Level = Level.OK, code: int = 0) -> None:
        self._state.log(time.time(), text, int(level), int(code))
        if level == Level.ERROR:  # a button did nothing: whoever pressed it may not have the log open
            self._state.put(sentence=text)


def _region(box: Box) -> TargetRegion:
    region = TargetRegion(center=matrix_to_pose(transform(position=box.centre)), size=to_vector3(box.size))
    region.header.frame_id = BASE_LINK
    return region


def main(args: list[str] | None = None) -> None:
    """Entry point of `ros2 run dgs_viewer viewer_node`."""
    os.nice(NICENESS)
    run(ViewerNode, args)
