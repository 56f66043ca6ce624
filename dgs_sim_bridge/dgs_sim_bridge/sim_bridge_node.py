"""The node that stands in for arm driver, hand and camera: the simulated world behind the hardware's own interfaces."""

from __future__ import annotations

import queue
import threading
import time
import traceback
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from control_msgs.action import FollowJointTrajectory
from dgs_interfaces.msg import SimState
from dgs_interfaces.srv import InjectFault, SimReset
from geometry_msgs.msg import WrenchStamped
from rclpy.action import GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.qos import qos_profile_system_default
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, Image, JointState
from std_msgs.msg import Bool, Float64
from ur_dashboard_msgs.msg import SafetyMode
from ur_msgs.srv import SetPayload

from dgs_description.cell import CELL
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.joints import ARM_JOINTS
from dgs_description.parameters import parameter
from dgs_description.words import plural
from dgs_hand_driver.bus import bus_port
from dgs_ros.base_node import LATCHED, DgsNode, end_goal
from dgs_ros.diagnostics import Level
from dgs_ros.image_msgs import numpy_to_image, pinhole_to_camera_info
from dgs_ros.joint_msgs import to_joint_state
from dgs_ros.run import run
from dgs_ros.trajectory_msgs import to_time
from dgs_sim_bridge.hand.virtual_hand import VirtualHand
from dgs_sim_bridge.render.d455 import D455, D455Noise
from dgs_sim_bridge.render.meshes import link_meshes
from dgs_sim_bridge.render.object_model import find_catalogue
from dgs_sim_bridge.sim_msgs import goal_from_message, to_feedback, to_result, to_sim_state, to_wrench
from dgs_sim_bridge.world.arm_controller import Outcome
from dgs_sim_bridge.world.camera import Snapshot
from dgs_sim_bridge.world.faults import Faults
from dgs_sim_bridge.world.physics import forget_shapes
from dgs_sim_bridge.world.scenes import PlacedObject
from dgs_sim_bridge.world.simulation import Pacer, Simulation
from dgs_sim_bridge.world.trajectory import ArmState, FollowCode, SetPoint, TrajectoryRefused
from dgs_sim_bridge.world.world import random_scene

# The real driver does not publish in kinematic order either, so clients must map by name.
_PUBLISHED_ORDER = [1, 2, 3, 4, 5, 0]
_PUBLISHED_NAMES = [ARM_JOINTS[k] for k in _PUBLISHED_ORDER]
_MOST_PAYLOAD = 3.0
"""Of a UR3 [kg]."""
_FEEDBACK_PERIOD = 0.05
_CANCEL_PERIOD = 0.02
"""How often a running goal looks whether it is cancelled [s]."""
_RESET_TIMEOUT = 10.0
# As the drivers of the real hardware name and time them.
_ARM_ACTION = "/scaled_joint_trajectory_controller/follow_joint_trajectory"
_ARM_STATUS = "/io_and_status_controller"
_CAMERA = "/camera/camera"
_JOINT_STATE_PERIOD = 1 / 125
"""Of a UR3's controller, CB series [s, simulated]."""
_CLOCK_PERIOD = 1 / 50
"""[s, simulated]"""


@dataclass(frozen=True)
class SimParameters:
    """See the descriptions."""

    objects: int = parameter(5, "Objects of the first scene.", 0, 30)
    seed: int = parameter(0, "Seed of the first scene and of the camera's noise.", 0)
    catalogue: str = parameter("novel", "Objects to draw from: novel, household, train, or a file or folder.")
    models_dir: str = parameter(
        "", "Folder with the catalogues; empty = $DGS_MODELS_DIR or the repository's models."
    )
    real_time_factor: float = parameter(
        1.0, "Simulated seconds per second where the machine can; 0 = as fast as possible.", 0.0, 100.0
    )
    hand_port: int = parameter(
        0, "TCP port of the hand's CAN bus on loopback; 0 = 29536 + ROS_DOMAIN_ID.", 0, 65535
    )
    camera_rate: float = parameter(2.0, "Pictures while somebody listens [Hz, simulated].", 0.1, 30.0)
    transparent: float = parameter(0.0, "This share of a scene's objects is glass.", 0.0, 1.0)
    camera_noise: bool = parameter(True, "Whether depth has the errors of a D455.")


class SimBridgeNode(DgsNode[SimParameters]):
    """Runs the simulation in a thread of its own, and takes pictures in another one."""

    def __init__(self, **node_arguments: Any) -> None:
        """Begin to simulate. Raises DgsError: the catalogue is missing, the port of the hand's bus is in use."""
        super().__init__("sim_bridge_node", SimParameters, **node_arguments)
        self._hand_bus = VirtualHand(bus_port(self.parameters.hand_port))
        try:
            self._simulation = self._begin()
        except Exception:
            forget_shapes()  # `close` is not called then
            raise
        self._pacer = Pacer(self.parameters.real_time_factor)
        self._status: tuple[bool, int] | None = None
        self._payload = 0.0
        self._pending_picture: Snapshot | None = None
        self._picture_wanted = threading.Event()
        self._camera_ready = threading.Event()
        self._make_publishers()
        self._serve()
        targets = {"simulation": self._simulate, "camera": self._take_pictures}
        self._threads = [threading.Thread(target=t, name=name, daemon=True) for name, t in targets.items()]
        for thread in self._threads:
            thread.start()
        self.get_logger().info(f"hand's CAN bus (socketcand) on port {self._hand_bus.port}")

    def close(self) -> None:
        """Stop simulating, close the bus."""
        self.stopping.set()
        self._picture_wanted.set()
        for thread in self._threads:
            thread.join(1.5)
        self._hand_bus.stop()
        forget_shapes()

    # set-up

    def _make_publishers(self) -> None:
        images = qos_profile_system_default
        self._joint_states = self.create_publisher(JointState, "/joint_states", 10)
        self._wrench = self.create_publisher(WrenchStamped, "/force_torque_sensor_broadcaster/wrench", 10)
        self._clock_topic = self.create_publisher(Clock, "/clock", 10)
        self._depth = self.create_publisher(Image, f"{_CAMERA}/depth/image_rect_raw", images)
        self._depth_info = self.create_publisher(CameraInfo, f"{_CAMERA}/depth/camera_info", images)
        self._colour = self.create_publisher(Image, f"{_CAMERA}/color/image_raw", images)
        left, right = (f"{_CAMERA}/infra{number}" for number in (1, 2))
        self._infrared = [self.create_publisher(Image, f"{t}/image_rect_raw", images) for t in (left, right)]
        self._infrared_info = [
            self.create_publisher(CameraInfo, f"{t}/camera_info", images) for t in (left, right)
        ]
        self._state = self.create_publisher(SimState, "/sim/state", LATCHED)
        self._program_running = self.create_publisher(Bool, f"{_ARM_STATUS}/robot_program_running", LATCHED)
        self._safety_mode = self.create_publisher(SafetyMode, f"{_ARM_STATUS}/safety_mode", LATCHED)
        scaling = "/speed_scaling_state_broadcaster/speed_scaling"
        self._speed_scaling = self.create_publisher(Float64, scaling, 10)

    def _serve(self) -> None:
        for kind, name, callback in (
            (SimReset, "/sim/reset", self._on_reset),
            (InjectFault, "/sim/inject_fault", self._on_fault),
            (SetPayload, f"{_ARM_STATUS}/set_payload", self._on_payload),
        ):
            self.create_service(kind, name, callback, callback_group=MutuallyExclusiveCallbackGroup())
        self.serve_action(FollowJointTrajectory, _ARM_ACTION, self._execute, self._on_goal)

    def _begin(self) -> Simulation:
        scene = self._make_scene(self.parameters.seed, self.parameters.objects, self.parameters.catalogue)
        try:
            self._hand_bus.start()
        except OSError as error:
            deaf = f"the hand's CAN bus cannot listen on port {self._hand_bus.port}: {error}"
            cure = "end the other simulator, or choose hand_port:= here and port:= of hand_driver_node"
            raise DgsError(ErrorCode.SIM_REQUEST, f"{deaf}; {cure}") from error
        return Simulation(scene, self._hand_bus)

    def _make_scene(self, seed: int, count: int, catalogue: str) -> list[PlacedObject]:
        models = find_catalogue(catalogue or self.parameters.catalogue, self.parameters.models_dir)
        return random_scene(models, count, seed, self.parameters.transparent)

    # the simulation's thread

    def _simulate(self) -> None:
        schedule = self._schedule()
        due = [self._simulation.time] * len(schedule)
        try:
            while not self.stopping.is_set():
                self._simulation.step()
                now = self._simulation.time
                for k, (period, action) in enumerate(schedule):
                    if now >= due[k]:
                        due[k] = max(due[k] + period, now - period)
                        action()
                time.sleep(self._pacer.delay(now))  # also a sleep of 0 lets the other threads in
        except Exception as error:
            if not self.stopping.is_set():
                self.get_logger().fatal(f"the simulation has failed\n{traceback.format_exc()}")
                self.report(Level.ERROR, f"the simulation has failed: {error}")
                self.context.try_shutdown()  # a robot that stands still for ever is of no use: the process ends
        finally:
            self._simulation.close()

    def _schedule(self) -> list[tuple[float, Callable[[], None]]]:
        """Period [s, simulated] and action of everything that is done now and then."""
        sim = self._simulation
        return [
            (_CLOCK_PERIOD, lambda: self._clock_topic.publish(Clock(clock=to_time(sim.time)))),
            (_JOINT_STATE_PERIOD, self._publish_joint_states),
            (1.0 / self.parameters.camera_rate, self._request_picture),
            (0.2, self._publish_state),
            (0.0, self._publish_robot_status),
            # In percent, as the driver's code does it.
            (0.1, lambda: self._speed_scaling.publish(Float64(data=100.0 * sim.speed_scaling))),
            (2.0, self._report_health),
        ]

    def _publish_joint_states(self) -> None:
        if self._simulation.faults.on("drop_joint_states"):
            return
        state, stamp = self._simulation.arm_state, to_time(self._simulation.time)
        measured = state.positions, state.velocities, state.efforts
        q, dq, tau = (values[_PUBLISHED_ORDER] for values in measured)
        self._joint_states.publish(to_joint_state(_PUBLISHED_NAMES, q, dq, tau, stamp))

        self._wrench.publish(to_wrench(self._simulation.world.wrench(), self._simulation.time))

    def _publish_state(self) -> None:
        sim = self._simulation
        self._state.publish(to_sim_state(sim.world.object_states(), sim.time))

    def _publish_robot_status(self) -> None:
        status = self._simulation.program_running, self._simulation.safety_mode
        if self._status != status:
            self._status = status
            self._program_running.publish(Bool(data=status[0]))
            self._safety_mode.publish(SafetyMode(mode=status[1]))

    def _report_health(self) -> None:
        factor = self._pacer.measure(self._simulation.time)
        faults = self._simulation.faults.names
        self.report(
            Level.WARN if faults else Level.OK,
            f"simulating with faults: {', '.join(faults)}" if faults else "simulating",
            real_time_factor=f"{factor:.2f}",
            faults=", ".join(faults),
            hands=self._hand_bus.clients,
            payload=f"{self._payload:.3f}",
        )

    def _request_picture(self) -> None:
        publishers = (self._depth, self._depth_info, self._colour, *self._infrared)
        wanted = any(publisher.get_subscription_count() for publisher in publishers)
        if wanted and self._camera_ready.is_set() and not self._simulation.faults.on("freeze_camera"):
            self._pending_picture = self._simulation.world.snapshot()
            self._picture_wanted.set()

    # the camera's thread

    def _take_pictures(self) -> None:
        noise = D455Noise() if self.parameters.camera_noise else None
        rng = np.random.default_rng(self.parameters.seed)
        link_meshes()  # takes a while the first time, which must not hold up the simulation
        self._camera_ready.set()
        while not self.stopping.is_set():
            self._picture_wanted.wait()
            self._picture_wanted.clear()
            snapshot, self._pending_picture = self._pending_picture, None
            if snapshot is None or self.stopping.is_set():
                continue
            try:
                self._publish_picture(snapshot, noise, rng)
            except Exception as error:
                if not self.stopping.is_set():
                    self.get_logger().error(f"no picture\n{traceback.format_exc()}")
                    self.report_event(Level.ERROR, f"no picture: {error}", "camera")

    def _publish_picture(self, snapshot: Snapshot, noise: D455Noise | None, rng: np.random.Generator) -> None:
        left, right = (publisher.get_subscription_count() > 0 for publisher in self._infrared)
        shot = snapshot.shot(noise, rng, imagers=2 if right else int(left))
        stamp = to_time(snapshot.time)
        millimetres = np.rint(np.minimum(shot.depth, 65.0) * 1000).astype(np.uint16)
        self._depth_info.publish(pinhole_to_camera_info(D455, CELL.optical_frame, stamp))
        self._depth.publish(numpy_to_image(millimetres, CELL.optical_frame, stamp))
        if self._colour.get_subscription_count():
            self._colour.publish(numpy_to_image(snapshot.colour(shot.truth), CELL.optical_frame, stamp))
        for k, image in enumerate((shot.left, shot.right)):
            if image is not None:
                info = pinhole_to_camera_info(D455, CELL.optical_frame, stamp, k * D455Noise.baseline)
                self._infrared_info[k].publish(info)
                self._infrared[k].publish(numpy_to_image(image, CELL.optical_frame, stamp))

    # services

    def _on_reset(self, request: SimReset.Request, response: SimReset.Response) -> SimReset.Response:
        try:
            scene = self._make_scene(request.seed, request.objects, request.catalogue)
        except DgsError as error:
            response.error_code, response.message = int(error.code), error.message
            return response
        standing = threading.Event()

        def on_standing() -> None:
            self._publish_state()  # who has the answer reads nothing of the old scene any more
            standing.set()

        self._simulation.reset(scene, on_standing)
        # The swap waits for the step in work only; the bound is for a simulation that has died.
        if not standing.wait(_RESET_TIMEOUT):
            response.error_code = int(ErrorCode.SIM_SCENE)
            response.message = "the simulation does not run any more"
            return response
        response.object_names = [item.model.name for item in scene]
        response.message = f"the table has {plural(len(scene), 'object')} on it"
        return response

    def _on_fault(self, request: InjectFault.Request, response: InjectFault.Response) -> InjectFault.Response:
        try:
            Faults.check(request.fault, request.target, request.duration)
        except DgsError as error:
            response.error_code, response.message = int(error.code), error.message
            return response
        self._simulation.inject(request.fault, request.target, request.duration)
        once = "for one goal" if request.fault == "abort_arm_goal" else "until clear"
        until = f"for {request.duration:g} s" if request.duration > 0 else once
        off = request.fault == "clear"
        response.message = "all faults are off" if off else f"{request.fault} is on {until}"
        return response

    def _on_payload(self, request: SetPayload.Request, response: SetPayload.Response) -> SetPayload.Response:
        response.success = 0.0 <= request.mass <= _MOST_PAYLOAD
        if response.success:
            self._payload = request.mass
            self.get_logger().info(f"payload {request.mass:.3f} kg")
        return response

    # the trajectory action

    def _on_goal(self, message: FollowJointTrajectory.Goal) -> GoalResponse:
        try:
            if not self._simulation.program_running:
                raise TrajectoryRefused(FollowCode.INVALID_GOAL, "the robot's program does not run")
            goal_from_message(message, self._simulation.time, warn=self.get_logger().warning)
        except TrajectoryRefused as refusal:
            sentence = f"trajectory refused: {refusal.message}"
            self.get_logger().warning(sentence)
            self.report_event(Level.WARN, sentence, "arm", code=int(refusal.code))
            return GoalResponse.REJECT
        return GoalResponse.ACCEPT

    def _execute(self, handle: ServerGoalHandle) -> FollowJointTrajectory.Result:
        ends: queue.SimpleQueue[Outcome] = queue.SimpleQueue()
        next_feedback = 0.0

        def on_progress(wanted: SetPoint, measured: ArmState, passed: float) -> None:
            nonlocal next_feedback
            now = self._simulation.time
            if now >= next_feedback:
                next_feedback = now + _FEEDBACK_PERIOD
                handle.publish_feedback(to_feedback(wanted, measured, passed, now))

        # It was judged when it came: one whose end has passed since then is not refused any more.
        goal = goal_from_message(handle.request, 0.0, ends.put, on_progress)
        self._simulation.start_goal(goal)
        while not self.stopping.is_set():
            if handle.is_cancel_requested:
                self._simulation.cancel_goal(goal)
            with suppress(queue.Empty):
                return self._finish(handle, ends.get(timeout=_CANCEL_PERIOD))
        return FollowJointTrajectory.Result()

    def _finish(self, handle: ServerGoalHandle, outcome: Outcome) -> FollowJointTrajectory.Result:
        if self.stopping.is_set():
            return to_result(outcome)
        if outcome.status not in ("succeeded", "canceled"):
            self.get_logger().warning(f"trajectory aborted: {outcome.message}")
        end_goal(handle, outcome.status == "succeeded", outcome.status == "canceled")
        return to_result(outcome)


def main(args: list[str] | None = None) -> None:
    """Run the node."""
    run(SimBridgeNode, args)
