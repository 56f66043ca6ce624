"""The hand's node: action /dexhand/move and topic /dexhand/joint_states over the CAN bus."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from dgs_interfaces.action import MoveHand
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup, ReentrantCallbackGroup
from rclpy.clock import Clock, ClockType
from sensor_msgs.msg import JointState

from dgs_description.errors import DgsError, ErrorCode
from dgs_description.joints import HAND_JOINTS
from dgs_hand_driver.admittance import AdmittanceGains
from dgs_hand_driver.bus import BusSettings, open_bus
from dgs_hand_driver.can_protocol import HandProtocol
from dgs_hand_driver.connection import HandConnection
from dgs_hand_driver.hand import DexHand, HandSettings
from dgs_hand_driver.hand_state import HandState
from dgs_hand_driver.move_goal import GoalSettings, parse_goal
from dgs_hand_driver.move_monitor import MoveOutcome, MoveSettings
from dgs_ros.base_node import DgsNode
from dgs_ros.diagnostics import Level
from dgs_ros.joint_msgs import to_joint_state
from dgs_ros.parameters import parameter
from dgs_ros.run import run

FEEDBACK_PERIOD = 0.1
"""[s]"""


@dataclass(frozen=True)
class HandDriverParameters:
    """Parameters of the node. Triples are yaw, pitch, middle; fives are thumb, index, middle, ring, little."""

    interface: str = parameter(
        "socketcand", "python-can interface: socketcan, pcan, socketcand (simulator), ..."
    )
    channel: str = parameter("can0", "Channel of the interface.")
    host: str = parameter("127.0.0.1", "Host of the socketcand server; other interfaces do not use it.")
    port: int = parameter(29536, "Port of the socketcand server.", minimum=1, maximum=65535)
    bitrate: int = parameter(1_000_000, "Of the CAN bus [bit/s].", minimum=10_000, maximum=1_000_000)
    dbc: str = parameter("", "CAN database to use in place of the package's own; empty = own.")
    yaw_command_signs: tuple[float, float, float, float, float] = parameter(
        (1.0,) * 5, "Direction of the commanded yaw of every finger on this hand.", choices=(1.0, -1.0)
    )
    yaw_state_signs: tuple[float, float, float, float, float] = parameter(
        (1.0,) * 5, "Direction of the measured yaw of every finger on this hand.", choices=(1.0, -1.0)
    )
    default_speed: float = parameter(1.0, "For goals with speed 0 [rad/s].", minimum=0.02, maximum=3.14)
    max_speed: float = parameter(2.09, "Faster goals are refused [rad/s].", minimum=0.02, maximum=3.14)
    preempt: bool = parameter(False, "A new goal replaces the running one instead of being refused as busy.")
    closing_margin: tuple[float, float, float] = parameter(
        (0.0, 0.20, 0.14),
        "Added to a grasp's final joints as the closing target [rad].",
        minimum=0.0,
        maximum=0.5,
    )
    silence_timeout: float = parameter(5.0, "Wall time without joint states [s].", minimum=0.1, maximum=60.0)
    bus_timeout: float = parameter(3.0, "Wall time without any frame [s].", minimum=0.5, maximum=60.0)
    position_tolerance: float = parameter(
        0.02, "Every joint this close: arrived [rad].", minimum=0.001, maximum=0.2
    )
    settled_tolerance: float = parameter(
        0.08, "Still and this close: arrived as well [rad].", minimum=0.001, maximum=0.5
    )
    blocked_torque: tuple[float, float, float] = parameter(
        (0.6, 0.6, 0.6), "Unexpected contact in position mode [Nm].", minimum=0.01, maximum=5.0
    )
    blocked_time: float = parameter(0.15, "For so long [s].", minimum=0.0, maximum=5.0)
    contact_torque: tuple[float, float, float] = parameter(
        (0.3, 0.15, 0.15), "Contact of a closing finger; yaw says nothing [Nm].", minimum=0.01, maximum=5.0
    )
    contact_lag: float = parameter(
        0.05, "Or stopped so far before its target [rad].", minimum=0.005, maximum=0.5
    )
    still_time: float = parameter(
        0.3, "Standing still for so long ends a move [s].", minimum=0.05, maximum=5.0
    )
    timeout_factor: float = parameter(3.0, "Times the time that the way takes.", minimum=1.0, maximum=100.0)
    timeout_extra: float = parameter(3.0, "Plus this [s].", minimum=0.1, maximum=60.0)

    def bus(self) -> BusSettings:
        """Which bus to open."""
        return BusSettings(self.interface, self.channel, self.host, self.port, self.bitrate)

    def goal(self) -> GoalSettings:
        """Bounds of a goal."""
        return GoalSettings(default_speed=min(self.default_speed, self.max_speed), max_speed=self.max_speed)

    def hand(self) -> HandSettings:
        """Timeouts and tolerances."""
        gains = AdmittanceGains(margin=(*self.closing_margin, self.closing_margin[2]))
        move = MoveSettings(
            position_tolerance=self.position_tolerance,
            settled_tolerance=self.settled_tolerance,
            blocked_torque=self.blocked_torque,
            blocked_time=self.blocked_time,
            contact_torque=self.contact_torque,
            contact_lag=self.contact_lag,
            still_time=self.still_time,
            timeout_factor=self.timeout_factor,
            timeout_extra=self.timeout_extra,
        )
        return HandSettings(
            silence=self.silence_timeout,
            bus_timeout=self.bus_timeout,
            yaw_command_signs=self.yaw_command_signs,
            yaw_state_signs=self.yaw_state_signs,
            gains=gains,
            move=move,
        )


class HandDriverNode(DgsNode[HandDriverParameters]):
    """Serves one hand. Starts without it: goals answer HAND_BUS until the bus can be opened."""

    def __init__(self, **node_arguments: Any) -> None:
        """Read the parameters, begin to connect, offer the action."""
        super().__init__("hand_driver_node", HandDriverParameters, **node_arguments)
        self._goal_settings = self.parameters.goal()
        self._hand_settings = self.parameters.hand()
        self._protocol = HandProtocol(self.parameters.dbc or None)
        self._mover = threading.Lock()
        self._turn = threading.Lock()
        self._give_way = threading.Event()
        self._joint_states = self.create_publisher(JointState, "/dexhand/joint_states", 10)
        bus = self.parameters.bus()
        self._connection = HandConnection(lambda: open_bus(bus), self._make_hand)
        self._status_timer = self.create_timer(
            0.5,
            self._report_status,
            callback_group=MutuallyExclusiveCallbackGroup(),
            clock=Clock(clock_type=ClockType.STEADY_TIME),
        )
        self._server = ActionServer(
            self,
            MoveHand,
            "/dexhand/move",
            execute_callback=self._execute,
            # Every goal is accepted and answered with a code: a rejected goal could not say why.
            goal_callback=lambda _: GoalResponse.ACCEPT,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
            callback_group=ReentrantCallbackGroup(),
        )

    def close(self) -> None:
        """Let a running move end (it holds the hand where it is), then close the bus."""
        if self._mover.acquire(timeout=1.0):
            self._mover.release()
        self._connection.close()

    def _make_hand(self, bus: Any) -> DexHand:
        return DexHand(bus, self._hand_settings, self._protocol, self._publish)

    def _publish(self, state: HandState) -> None:
        if self.stopping.is_set():
            return
        stamp = self.get_clock().now().to_msg()
        self._joint_states.publish(
            to_joint_state(HAND_JOINTS, state.positions, efforts=state.torques, stamp=stamp)
        )

    def _report_status(self) -> None:
        try:
            hand = self._connection.hand()
            state = hand.state()
        except DgsError as error:
            self.report(Level.ERROR, error.message, code=int(error.code))
            return
        figures: dict[str, Any] = {
            "mode": state.mode,
            "states": state.cycle,
            "dropped states": hand.incomplete_cycles,
        }
        if hand.fault is not None:
            self.report(Level.ERROR, hand.fault, code=int(ErrorCode.HAND_INTERNAL), **figures)
        else:
            self.report(Level.OK, "connected to the hand", **figures)

    def _execute(self, goal_handle: ServerGoalHandle) -> MoveHand.Result:
        result = MoveHand.Result(joint_names=list(HAND_JOINTS))
        try:
            outcome = self._move(goal_handle)
            result.error_code, result.message = int(outcome.code), outcome.message
            result.positions = outcome.state.positions.tolist()
            result.fingers_in_contact = list(outcome.fingers_in_contact)
        except DgsError as error:
            result.error_code, result.message = int(error.code), error.message
        except Exception as error:
            self.get_logger().error(f"move failed: {error!r}")
            result.error_code = int(ErrorCode.HAND_INTERNAL)
            result.message = f"internal error of the hand driver: {error!r}"
        if not self.stopping.is_set():
            _finish(goal_handle, result.error_code)
        return result

    def _move(self, goal_handle: ServerGoalHandle) -> MoveOutcome:
        request = goal_handle.request
        goal = parse_goal(
            request.joint_names, request.positions, request.speed, request.mode, self._goal_settings
        )
        self._take_the_hand()
        try:
            hand = self._connection.hand()
            cancelled = self._cancelled(goal_handle)
            outcome = hand.move(goal, _Feedback(goal_handle), cancelled)
            if outcome.code == ErrorCode.HAND_CANCELLED and self._give_way.is_set():
                outcome = replace(outcome, message="replaced by a newer goal; the hand holds where it is")
            return outcome
        finally:
            self._mover.release()

    def _take_the_hand(self) -> None:
        """Become the only mover. Raises DgsError HAND_BUSY."""
        if not self.parameters.preempt:
            if not self._mover.acquire(blocking=False):
                raise DgsError(
                    ErrorCode.HAND_BUSY, "the hand is executing another goal; cancel it or wait for its end"
                )
            return
        if not self._turn.acquire(blocking=False):
            raise DgsError(ErrorCode.HAND_BUSY, "another goal is just about to replace the running one")
        try:
            self._give_way.set()
            if not self._mover.acquire(timeout=self.parameters.silence_timeout):
                raise DgsError(ErrorCode.HAND_BUSY, "the running goal did not give way")
        finally:
            self._give_way.clear()
            self._turn.release()

    def _cancelled(self, goal_handle: ServerGoalHandle) -> Callable[[], bool]:
        return lambda: goal_handle.is_cancel_requested or self._give_way.is_set() or self.stopping.is_set()


class _Feedback:
    """Sends the progress on at 10 Hz."""

    def __init__(self, goal_handle: ServerGoalHandle) -> None:
        self._goal_handle = goal_handle
        self._next = 0.0

    def __call__(self, state: HandState, progress: float) -> None:
        now = time.monotonic()
        if now < self._next:
            return
        self._next = now + FEEDBACK_PERIOD
        feedback = MoveHand.Feedback(joint_names=list(HAND_JOINTS), positions=state.positions.tolist())
        feedback.progress = float(progress)
        self._goal_handle.publish_feedback(feedback)


def _finish(goal_handle: ServerGoalHandle, code: int) -> None:
    if code == ErrorCode.SUCCESS:
        goal_handle.succeed()
    elif code == ErrorCode.HAND_CANCELLED and goal_handle.is_cancel_requested:
        goal_handle.canceled()
    else:
        goal_handle.abort()


def main(args: list[str] | None = None) -> None:
    """Run the node until SIGINT."""
    run(HandDriverNode, args)
