"""The hand's node: action /dexhand/move, topics /dexhand/joint_states and /dexhand/fingertips over the CAN bus."""

from __future__ import annotations

import threading
import time
import traceback
from dataclasses import dataclass
from functools import partial
from itertools import compress
from typing import Any

from dgs_interfaces.action import MoveHand
from dgs_interfaces.msg import Fingertips
from rclpy.action.server import ServerGoalHandle
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool

from dgs_description.errors import DgsError, ErrorCode
from dgs_description.hand import HAND
from dgs_description.parameters import ManagedParameters, parameter
from dgs_hand_driver.bus import BusSettings
from dgs_hand_driver.fingertips import SlipWatch, in_contact
from dgs_hand_driver.hand import DexHand
from dgs_hand_driver.hand_settings import HandSettings
from dgs_hand_driver.hand_state import HandState
from dgs_hand_driver.move_goal import DEFAULT_SPEED, MIN_SPEED, parse_goal
from dgs_hand_driver.move_monitor import MoveOutcome
from dgs_hand_driver.protocol import NO_FINGER
from dgs_ros.base_node import LATCHED, end_goal
from dgs_ros.diagnostics import Level
from dgs_ros.joint_msgs import to_joint_state
from dgs_ros.managed_node import ManagedNode
from dgs_ros.presence import watch_client
from dgs_ros.run import run

FEEDBACK_PERIOD = 0.1
"""[s]"""
RESET_NEWS = 1.0
"""A goal waits so long for the news of the reset that allows it, which may come behind it [s]."""
STOPPED = "motion is stopped until somebody calls /reset of the arm executor"
FASTEST = max(3.14, HAND.speed)
"""That a parameter may allow [rad/s]."""


@dataclass(frozen=True)
class HandDriverParameters(ManagedParameters, HandSettings, BusSettings):
    """Parameters of the node. Triples are yaw, pitch, middle; signs are of every finger."""

    default_speed: float = parameter(DEFAULT_SPEED, "For goals with speed 0 [rad/s].", MIN_SPEED, FASTEST)
    max_speed: float = parameter(0.0, "Faster goals are refused; 0 = the hand's own [rad/s].", 0.0, FASTEST)


class HandDriverNode(ManagedNode[HandDriverParameters]):
    """Serves one hand. Starts without it: goals answer HAND_BUS until the bus can be opened."""

    def __init__(self, **node_arguments: Any) -> None:
        """Read the parameters, offer the action."""
        super().__init__("hand_driver_node", HandDriverParameters, **node_arguments)
        self._mover = threading.Lock()
        self._may_move = threading.Event()
        self._may_move.set()
        self._next_feedback = 0.0
        self._joint_states = self.create_publisher(JointState, "/dexhand/joint_states", 10)
        self._fingertips = self.create_publisher(Fingertips, "/dexhand/fingertips", 10)
        self._slip = SlipWatch(self.parameters.contact_force)
        self._slipping = NO_FINGER
        self._hand: DexHand | None = None
        self.create_subscription(Bool, "/dgs/stopped", self._on_stopped, LATCHED)
        self.serve_action(MoveHand, "/dexhand/move", self._execute)

    def start(self) -> None:
        """Begin to connect."""
        given = self.parameters
        self._hand = DexHand(given, given, self._publish)
        self.every(0.5, self._report_status)

    def close(self) -> None:
        """Close the bus; a running move has ended, and the hand holds where it is."""
        if self._hand is not None:
            self._hand.close()

    @property
    def hand(self) -> DexHand:
        """The hand; raises DgsError NODE_INACTIVE before the node is active."""
        self.require_active()
        assert self._hand is not None
        return self._hand

    def _on_stopped(self, stopped: Bool) -> None:
        (self._may_move.clear if stopped.data else self._may_move.set)()

    def _publish(self, state: HandState) -> None:
        if self.stopping.is_set() or not self.active:
            return
        stamp, torques = self.get_clock().now().to_msg(), state.torques
        message = to_joint_state(HAND.joints, state.positions, efforts=torques, stamp=stamp)
        self._joint_states.publish(message)
        if state.forces is not None:
            self._slipping = tuple(self._slip.update(state.clock, state.forces).tolist())
            self._fingertips.publish(
                Fingertips(
                    header=message.header,
                    fingers=list(HAND.fingers),
                    normal=state.forces[:, 0].tolist(),
                    tangential=state.forces[:, 1].tolist(),
                    contact=in_contact(state.forces, self.parameters.contact_force).tolist(),
                    slip=list(self._slipping),
                )
            )

    def _report_status(self) -> None:
        try:
            hand = self.hand
            state = hand.state()
        except DgsError as error:
            self.report(Level.ERROR, error.message, code=int(error.code))
            return
        figures: dict[str, Any] = {"mode": state.mode, "states": state.cycle}
        figures["dropped states"] = hand.incomplete_cycles
        if any(self._slipping):
            figures["slipping"] = ", ".join(compress(HAND.fingers, self._slipping))
        fault = hand.fault
        if fault is not None:
            self.report(Level.ERROR, fault.message, code=int(fault.code), **figures)
        else:
            self.report(Level.OK, "connected to the hand", **figures)

    def _execute(self, goal_handle: ServerGoalHandle) -> MoveHand.Result:
        result = MoveHand.Result(joint_names=list(HAND.joints))
        try:
            outcome = self._move(goal_handle)
            result.error_code, result.message = int(outcome.code), outcome.message
            result.positions = outcome.state.positions.tolist()
            result.fingers_in_contact = list(outcome.fingers_in_contact)
        except DgsError as error:
            result.error_code, result.message = int(error.code), error.message
        except Exception as error:
            self.get_logger().error(f"move failed\n{traceback.format_exc()}")
            result.error_code = int(ErrorCode.HAND_INTERNAL)
            result.message = f"internal error of the hand driver: {error!r}"
        code = result.error_code
        end_goal(goal_handle, code == ErrorCode.SUCCESS, code == ErrorCode.HAND_CANCELLED)
        return result

    def _move(self, goal_handle: ServerGoalHandle) -> MoveOutcome:
        hand, r, p = self.hand, goal_handle.request, self.parameters
        asked = r.joint_names, r.positions, r.speed, r.mode, r.active_fingers
        goal = parse_goal(*asked, p.default_speed, p.max_speed or HAND.speed)
        if not self._may_move.wait(RESET_NEWS):
            raise DgsError(ErrorCode.STOPPED, STOPPED)
        client = watch_client(self, "/dexhand/move", goal_handle.goal_id)

        def cancelled() -> str:
            if client.lost():
                return "the node that asked for it has gone"
            if not self.active:
                return "the hand driver was deactivated"
            if not self._may_move.is_set():
                return STOPPED
            return "cancelled" if goal_handle.is_cancel_requested or self.stopping.is_set() else ""

        if not self._mover.acquire(blocking=False):
            busy = "the hand is executing another goal; cancel it or wait for its end"
            raise DgsError(ErrorCode.HAND_BUSY, busy)
        try:
            return hand.move(goal, partial(self._send_feedback, goal_handle), cancelled)
        finally:
            self._mover.release()

    def _send_feedback(self, goal_handle: ServerGoalHandle, state: HandState, progress: float) -> None:
        if time.monotonic() < self._next_feedback:
            return
        self._next_feedback = time.monotonic() + FEEDBACK_PERIOD
        names, positions = list(HAND.joints), state.positions.tolist()
        feedback = MoveHand.Feedback(joint_names=names, positions=positions, progress=float(progress))
        goal_handle.publish_feedback(feedback)


def main(args: list[str] | None = None) -> None:
    """Run the node until SIGINT."""
    run(HandDriverNode, args)
