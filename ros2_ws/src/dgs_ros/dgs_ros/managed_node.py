"""A node with the states of ROS 2's lifecycle: configured it has opened and loaded what it needs, active it serves.

By itself it becomes active as soon as it can. With `autostart:=false` it waits for `ros2 lifecycle set`.
"""

from __future__ import annotations

import threading
import traceback
from typing import Any, TypeVar

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.lifecycle import LifecycleNodeMixin, LifecycleState, TransitionCallbackReturn

from dgs_description.errors import DgsError, ErrorCode
from dgs_description.parameters import ManagedParameters
from dgs_ros.answers import patiently
from dgs_ros.base_node import DgsNode
from dgs_ros.diagnostics import Level

SUCCESS, FAILURE = TransitionCallbackReturn.SUCCESS, TransitionCallbackReturn.FAILURE


P = TypeVar("P", bound=ManagedParameters)


class ManagedNode(LifecycleNodeMixin, DgsNode[P]):
    """A node whose work `start` begins and which serves while it is `active`.

    A failed configuring can be tried again. There is no way back from configured: end the process instead.
    """

    def __init__(self, name: str, parameters: type[P], **node_arguments: Any) -> None:
        """As `DgsNode`; the node is unconfigured."""
        DgsNode.__init__(self, name, parameters, **node_arguments)
        self._active = threading.Event()
        self._why_not: DgsError | None = None
        self._paused = False
        own = set(self.services)
        LifecycleNodeMixin.__init__(self, callback_group=MutuallyExclusiveCallbackGroup())
        for service in set(self.services) - own:
            service.send_response = patiently(service.send_response)
        change = self._service_change_state.callback

        def answer(request: Any, response: Any) -> Any:
            try:
                return change(request, response)
            except Exception as error:
                # A transition that is not possible now; rclpy would leave the client waiting.
                self.get_logger().warning(f"no such change of state now: {error}")
                response.success = False
                return response

        self._service_change_state.callback = answer

    # for the node

    def start(self) -> None:
        """Open devices, load what takes long; override it. Called once it is to be configured."""

    def serve(self) -> None:
        """Offer what nobody should see earlier; override it. Called whenever the node becomes active."""

    @property
    def active(self) -> bool:
        """Whether the node may serve."""
        return self._active.is_set()

    def require_active(self) -> None:
        """Raise DgsError NODE_INACTIVE, with what to do, unless the node is active."""
        if not self.active:
            name, state = self.get_fully_qualified_name(), self._state_machine.current_state[1]
            step = "configure" if state == "unconfigured" else "activate"
            cure = f"ros2 lifecycle set {name} {step}"
            if state == "finalized":
                cure = "end its process and start it again"
            raise DgsError(ErrorCode.NODE_INACTIVE, f"{name} is {state}: {cure}")

    # for the lifecycle

    def prepare(self) -> None:
        """Become active, if the node is to do so by itself; raises what `start` raised."""
        if not self.parameters.autostart:
            self.get_logger().info("waits to be configured and activated")
            return
        if self.trigger_configure() != SUCCESS:
            assert self._why_not is not None
            raise self._why_not
        self.trigger_activate()

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Start; what hinders it is logged and reported, and the node stays unconfigured."""
        try:
            self.report(Level.OK, "configuring")  # what hindered it before is over
            self.start()
        except Exception as error:
            wrong = error if isinstance(error, DgsError) else DgsError(ErrorCode.NODE_INTERNAL, repr(error))
            if wrong is not error:
                self.get_logger().error(traceback.format_exc())
            self._why_not = wrong
            self.get_logger().error(f"not configured: {wrong.message}")
            self.report(Level.ERROR, wrong.message, code=int(wrong.code))
            return FAILURE
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Serve from now on."""
        self._active.set()
        self.serve()
        if self._paused:
            self.report(Level.OK, "active again", "lifecycle")
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Serve no longer; devices stay open."""
        self._active.clear()
        self._paused = True
        self.report(Level.WARN, "inactive", "lifecycle")
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Refuse: a process that ends and starts anew is the way to let go of devices and weights."""
        self.get_logger().warning("cleaning up is not offered: end this process and start it again")
        return FAILURE

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Serve no longer, for good; the process ends by a signal, as ever."""
        self._active.clear()
        self.report(Level.WARN, "finalized", "lifecycle")
        return super().on_shutdown(state)

    def destroy_node(self) -> None:
        """Also let go of the state machine, which would keep the DDS participant and its shared memory."""
        super().destroy_node()
        if hasattr(self, "_state_machine"):  # not where parameters were refused
            self._state_machine.destroy_when_not_in_use()
