"""The base class of all nodes: checked parameters and /diagnostics.

class CameraNode(DgsNode[CameraParameters]):
    def __init__(self, **node_arguments: Any) -> None:
        super().__init__("camera_node", CameraParameters, **node_arguments)

def main(args: list[str] | None = None) -> None:
    run(CameraNode, args)  # of dgs_ros.run
"""

from __future__ import annotations

import dataclasses
import math
import threading
import traceback
from collections.abc import Callable
from typing import Any, Generic, TypeVar, get_args, get_type_hints

from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    ParameterValue,
    SetParametersResult,
)
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import CallbackGroup, MutuallyExclusiveCallbackGroup, ReentrantCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.exceptions import InvalidParameterTypeException, NameValidationException
from rclpy.executors import Executor
from rclpy.expand_topic_name import expand_topic_name
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.service import Service
from rclpy.subscription import Subscription
from rclpy.timer import Timer
from rclpy.validate_full_topic_name import validate_full_topic_name

from dgs_description import malloc
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.parameters import constraints_of, declared, from_values
from dgs_description.words import shortened
from dgs_ros.action_server import CountingActionServer
from dgs_ros.answers import patiently
from dgs_ros.diagnostics import EVENT_LASTS, Level, StatusBoard
from dgs_ros.executors import POOL_THREADS, PoolExecutor, StreamExecutor, StreamGroup

P = TypeVar("P")

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""Of a topic whose newest message late listeners get, too."""

TRIM_EVERY = 20.0
"""Holes in the heap go back to the kernel so often [s].

Clouds and searches of changing size leave some after every call, and a node would grow for hours though it keeps
nothing; a trim takes 2 ms, and the call after it 16 ms more.
"""
_ROS_PARAMETERS = ("use_sim_time", "start_type_description_service")
_ROS_PARAMETER_PREFIX = "qos_overrides."


class DgsNode(Node, Generic[P]):
    """A node whose parameters arrive as an instance of a frozen dataclass, and which publishes /diagnostics.

    Attributes:
        parameters: the values, checked; they do not change while the node runs (a set request is refused).
        stopping: set when the node is asked to end; loops in own threads watch it.
        streams: callback group of subscriptions that name none, /clock among them: their callbacks must return at once.
        pool_threads: callbacks that may take long and run at the same time.
    """

    pool_threads = POOL_THREADS

    def __init__(self, name: str, parameters: type[P], **node_arguments: Any) -> None:
        """Declare the fields that `dgs_description.parameters.parameter` made; other arguments are of `Node`.

        Raises:
            DgsError: PARAMETER_INVALID: an unknown name, a wrong type, a value out of bounds, or a topic or service
                that cannot be one was given.
        """
        self.streams = StreamGroup()
        self._stream_executor: StreamExecutor | None = None
        self._servers: list[CountingActionServer] = []
        try:
            super().__init__(name, **node_arguments)
        except InvalidParameterTypeException as error:  # of use_sim_time, which is rclpy's own
            raise DgsError(ErrorCode.PARAMETER_INVALID, str(error)) from error
        self.stopping = threading.Event()
        try:
            self.parameters = self._read_parameters(parameters)
        except DgsError:
            self.destroy_node()
            raise
        self.add_on_set_parameters_callback(_keep_clock)
        self._board = StatusBoard(self.get_fully_qualified_name()[1:])
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self.every(1.0, self._publish_diagnostics)
        self.every(TRIM_EVERY, malloc.trim)

    def create_subscription(self, *args: Any, **keywords: Any) -> Subscription:
        """As `Node.create_subscription`; without a callback group of its own it is one of the `streams`."""
        keywords["callback_group"] = keywords.get("callback_group") or self.streams
        subscription: Subscription = super().create_subscription(*args, **keywords)
        if self._stream_executor is not None:
            self._stream_executor.wake()
        return subscription

    def create_service(self, kind: Any, name: str, callback: Callable, **keywords: Any) -> Service:
        """As `Node.create_service`; a callback that raises is answered too, if the response has a place for it.

        An answer that the middleware gives up is sent again (`dgs_ros.answers`).
        """

        def answer(request: Any, response: Any) -> Any:
            try:
                return callback(request, response)
            except Exception as error:
                self.get_logger().error(f"{name} failed\n{traceback.format_exc()}")
                code = error.code if isinstance(error, DgsError) else ErrorCode.NODE_INTERNAL
                sentence = error.message if isinstance(error, DgsError) else _unexpected(name, error)
                self.report_event(Level.ERROR, sentence, "callbacks", code=int(code))
                return _refuse(response, code, sentence)

        service: Service = super().create_service(kind, name, answer, **keywords)
        service.send_response = patiently(service.send_response)
        return service

    def every(self, period: float, callback: Callable[[], None], group: CallbackGroup | None = None) -> Timer:
        """Call back every `period` [s] of wall time, also while simulated time stands still."""
        clock = Clock(clock_type=ClockType.STEADY_TIME)
        return self.create_timer(period, callback, group or MutuallyExclusiveCallbackGroup(), clock)

    def serve_action(
        self,
        kind: Any,
        name: str,
        execute: Callable[[ServerGoalHandle], Any],
        judge: Callable[[Any], GoalResponse] = lambda _: GoalResponse.ACCEPT,
    ) -> ActionServer:
        """An action that grants every cancel; if nobody judges, every goal is accepted: a result can say why not."""
        server = CountingActionServer(
            self,
            kind,
            name,
            execute,
            goal_callback=judge,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
            callback_group=ReentrantCallbackGroup(),
        )
        self._servers.append(server)
        return server

    @property
    def unfinished_goals(self) -> int:
        """Goals of the node's actions whose clients have no result yet."""
        return sum(server.unfinished for server in self._servers)

    def make_executors(self) -> list[Executor]:
        """The executors that run the node's callbacks; each wants a thread."""
        self._stream_executor = StreamExecutor(self)
        return [self._stream_executor, PoolExecutor(self, self.pool_threads)]

    def report(
        self, level: Level, message: str, component: str = "", *, lasts: float = math.inf, **values: object
    ) -> None:
        """Set a diagnostic status; it is published once a second, and at once when the level changes.

        Every component of the node has its own status, with a sentence and figures; it is over after `lasts` [s]
        unless it is reported again.
        """
        if self._board.put(level, message, component, lasts, values):
            self._publish_diagnostics()

    def report_event(self, level: Level, message: str, component: str = "", **values: object) -> None:
        """As `report`, of a single event whose end nobody reports."""
        self.report(level, message, component, lasts=EVENT_LASTS, **values)

    def prepare(self) -> None:
        """Load what takes long and offer what needs it; override it. The node is ready when it returns."""

    def close(self) -> None:
        """Stop threads, close devices; override it. Called once when the node is to end, before it is destroyed.

        `stopping` is set by then, and the running goals have had time to end and to send their results.
        """

    def _publish_diagnostics(self) -> None:
        statuses = self._board.statuses()
        if not statuses or not self.context.ok():
            return
        array = DiagnosticArray(status=statuses)
        array.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(array)

    def _read_parameters(self, kind: type[P]) -> P:
        # rclpy's own way to declare overrides that nobody has declared yet fails at an empty list, whose value is None.
        given = {
            name: () if override.value is None else override.value
            for name, override in self._parameter_overrides.items()
            if name not in _ROS_PARAMETERS and not name.startswith(_ROS_PARAMETER_PREFIX)
        }
        parameters = from_values(kind, given)
        hints = get_type_hints(kind)
        for name, field in declared(kind).items():
            value = getattr(parameters, name)
            if name.endswith(("_topic", "topics", "_service")):
                for topic in value if isinstance(value, tuple) else (value,):
                    if topic or not constraints_of(field).optional:
                        check_topic(self, name, topic)
            if value == ():
                self._declare_empty(name, field, hints[name])
            else:
                self.declare_parameter(name, value, _descriptor(field, value), ignore_override=True)
        return parameters

    def _declare_empty(self, name: str, field: dataclasses.Field, hint: Any) -> None:
        """Declare a list without elements, which rclpy by itself takes for one of bytes."""
        self.declare_parameter(name, (), ParameterDescriptor(dynamic_typing=True), ignore_override=True)
        descriptor = _descriptor(field, ())
        descriptor.type = Parameter.Type.from_parameter_value([get_args(hint)[0]()]).value
        self.set_descriptor(name, descriptor, ParameterValue(type=descriptor.type))


def check_topic(node: Node, parameter: str, topic: str) -> None:
    """Raise DgsError PARAMETER_INVALID where ROS does not take a parameter's name for a topic, service or action."""
    try:
        validate_full_topic_name(expand_topic_name(topic, node.get_name(), node.get_namespace()))
    except (ValueError, NameValidationException) as error:
        said = " ".join(str(error).partition(", at ")[0].strip(" \n^").split())
        raise DgsError(ErrorCode.PARAMETER_INVALID, f"parameter {parameter!r}: {said}") from error


def end_goal(goal: ServerGoalHandle, succeeded: bool, cancelled: bool) -> None:
    """Set the final state of an action's goal; cancelled is only what somebody has asked to cancel."""
    if succeeded:
        goal.succeed()
    elif cancelled and goal.is_cancel_requested:
        goal.canceled()
    else:
        goal.abort()


def _unexpected(name: str, error: Exception) -> str:
    return f"{name} failed by an unexpected {type(error).__name__}, see the node's log: {error}"


def _keep_clock(changes: list[Parameter]) -> SetParametersResult:
    """Refuse what rclpy would take: another clock in the middle of the work."""
    if any(change.name == "use_sim_time" for change in changes):
        return SetParametersResult(successful=False, reason="use_sim_time is fixed when the node starts")
    return SetParametersResult(successful=True)


def _refuse(response: Any, code: ErrorCode, sentence: str) -> Any:
    """A new response, whatever was written into the old one."""
    refusal = type(response)()
    values = {"error_code": int(code), "success": False, "message": shortened(sentence)}
    for field in values.keys() & refusal.get_fields_and_field_types().keys():
        setattr(refusal, field, values[field])
    return refusal


def _descriptor(field: dataclasses.Field, value: object) -> ParameterDescriptor:
    """What `ros2 param describe` shows."""
    constraints = constraints_of(field)
    descriptor = ParameterDescriptor(
        description=constraints.description,
        additional_constraints=constraints.text(),
        read_only=True,
        type=Parameter.Type.from_parameter_value(value).value,
    )
    low, high = constraints.minimum, constraints.maximum
    if low is not None and high is not None:
        if isinstance(value, int) and not isinstance(value, bool):
            descriptor.integer_range = [IntegerRange(from_value=int(low), to_value=int(high), step=0)]
        elif isinstance(value, float):
            descriptor.floating_point_range = [FloatingPointRange(from_value=low, to_value=high, step=0.0)]
    return descriptor
