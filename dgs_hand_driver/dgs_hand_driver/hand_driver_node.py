"""The hand's node: action /dexhand/move and topic /dexhand/joint_states over the CAN bus."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from dgs_interfaces.action import MoveHand
from rclpy.action.server import ServerGoalHandle
from sensor_msgs.msg import JointState

from dgs_description.errors import DgsError, ErrorCode
from dgs_description.joints import HAND_JOINTS, HAND_SPEED
from dgs_description.parameters import parameter
from dgs_hand_driver.bus import BusSettings
from dgs_hand_driver.can_protocol import HandProtocol
from dgs_hand_driver.hand import DexHand, HandSettings
from dgs_hand_driver.hand_state import HandState
from dgs_hand_driver.move_goal import DEFAULT_SPEED, MIN_SPEED, parse_goal
from dgs_hand_driver.move_monitor import MoveOutcome
from dgs_ros.base_node import DgsNode, end_goal
from dgs_ros.diagnostics import Level
from dgs_ros.joint_msgs import to_joint_state
from dgs_ros.presence import watch_client
from dgs_ros.run import run

FEEDBACK_PERIOD = 0.1
"""[s]"""


@dataclass(frozen=True)
class HandDriverParameters(HandSettings, BusSettings):
    """Parameters of the node. Triples are yaw, pitch, middle; fives are thumb, index, middle, ring, little."""

    dbc: str = parameter("", "CAN database to use in place of the package's own; empty = own.")
    default_speed: float = parameter(DEFAULT_SPEED, "For goals with speed 0 [rad/s].", MIN_SPEED, 3.14)
    max_speed: float = parameter(HAND_SPEED, "Faster goals are refused [rad/s].", MIN_SPEED, 3.14)
    preempt: bool = parameter(False, "A new goal replaces the running one instead of being refused as busy.")


class HandDriverNode(DgsNode[HandDriverParameters]):
    """Serves one hand. Starts without it: goals answer HAND_BUS until the bus can be opened."""

    def __init__(self, **node_arguments: Any) -> None:
        """Read the parameters, begin to connect, offer the action."""
        super().__init__("hand_driver_node", HandDriverParameters, **node_arguments)
        self._mover = threading.Lock()
        self._turn = threading.Lock()
        self._give_way = threading.Event()
        self._next_feedback = 0.0
        self._joint_states = self.create_publisher(JointState, "/dexhand/joint_states", 10)
        given = self.parameters
        self._hand = DexHand(given, given, HandProtocol(given.dbc or None), self._publish)
        self.every(0.5, self._report_status)
        self.serve_action(MoveHand, "/dexhand/move", self._execute)

    def close(self) -> None:
        """Close the bus; a running move has ended, and the hand holds where it is."""
        self._hand.close()

    def _publish(self, state: HandState) -> None:
        if self.stopping.is_set():
            return
        stamp, torques = self.get_clock().now().to_msg(), state.torques
        message = to_joint_state(HAND_JOINTS, state.positions, efforts=torques, stamp=stamp)
        self._joint_states.publish(message)

    def _report_status(self) -> None:
        try:
            state = self._hand.state()
        except DgsError as error:
            self.report(Level.ERROR, error.message, code=int(error.code))
            return
        figures: dict[str, Any] = {"mode": state.mode, "states": state.cycle}
        figures["dropped states"] = self._hand.incomplete_cycles
        if self._hand.fault is not None:
            self.report(Level.ERROR, self._hand.fault, code=int(ErrorCode.HAND_INTERNAL), **figures)
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
        code = result.error_code
        end_goal(goal_handle, code == ErrorCode.SUCCESS, code == ErrorCode.HAND_CANCELLED)
        return result

    def _move(self, goal_handle: ServerGoalHandle) -> MoveOutcome:
        r, p = goal_handle.request, self.parameters
        asked = r.joint_names, r.positions, r.speed, r.mode, r.active_fingers
        goal = parse_goal(*asked, p.default_speed, p.max_speed)
        client = watch_client(self, "/dexhand/move", goal_handle.goal_id)
        self._take_the_hand()
        try:
            outcome = self._hand.move(
                goal,
                partial(self._send_feedback, goal_handle),
                lambda: (
                    goal_handle.is_cancel_requested
                    or self._give_way.is_set()
                    or self.stopping.is_set()
                    or client.lost()
                ),
            )
            if outcome.code == ErrorCode.HAND_CANCELLED and client.lost():
                outcome = replace(outcome, message="the node that asked for it has gone; the hand holds")
            if outcome.code == ErrorCode.HAND_CANCELLED and self._give_way.is_set():
                outcome = replace(outcome, message="replaced by a newer goal; the hand holds where it is")
            return outcome
        finally:
            self._mover.release()

    def _take_the_hand(self) -> None:
        """Become the only mover. Raises DgsError HAND_BUSY."""
        if not self.parameters.preempt:
            if not self._mover.acquire(blocking=False):
                busy = "the hand is executing another goal; cancel it or wait for its end"
                raise DgsError(ErrorCode.HAND_BUSY, busy)
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

    def _send_feedback(self, goal_handle: ServerGoalHandle, state: HandState, progress: float) -> None:
        if time.monotonic() < self._next_feedback:
            return
        self._next_feedback = time.monotonic() + FEEDBACK_PERIOD
        names, positions = list(HAND_JOINTS), state.positions.tolist()
        feedback = MoveHand.Feedback(joint_names=names, positions=positions, progress=float(progress))
        goal_handle.publish_feedback(feedback)


def main(args: list[str] | None = None) -> None:
    """Run the node until SIGINT."""
    run(HandDriverNode, args)
