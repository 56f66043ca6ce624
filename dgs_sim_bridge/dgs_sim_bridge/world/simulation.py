"""The running simulation: world, arm controller, the hand's end of the CAN bus and faults, stepped together. No ROS."""

from __future__ import annotations

import queue
import time
from collections.abc import Callable, Sequence

import numpy as np

from dgs_description.cell import HOME_ARM
from dgs_description.hand import HAND
from dgs_hand_driver.hand_state import STATE_PERIOD
from dgs_sim_bridge.hand.virtual_hand import VirtualHand
from dgs_sim_bridge.world.arm_controller import ArmController, ArmGoal
from dgs_sim_bridge.world.faults import Faults
from dgs_sim_bridge.world.physics import PHYSICS
from dgs_sim_bridge.world.scenes import PlacedObject
from dgs_sim_bridge.world.trajectory import FollowCode
from dgs_sim_bridge.world.world import World

START_TIME = 1.0
"""The clock starts here: time 0 means "no time yet" in ROS [s]."""


class Simulation:
    """Owned by one thread, which calls `step`; the methods below "any thread" only leave a request for it.

    Attributes:
        world: changes with every reset.
        faults: that are on.
        arm_state: measured joints after the last step.
    """

    def __init__(self, objects: Sequence[PlacedObject], hand_bus: VirtualHand) -> None:
        """Build the first world; the bus is started and stopped by the caller."""
        self.faults = Faults()
        self._bus = hand_bus
        self._requests: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._next_hand_state = START_TIME
        self._begin(World(objects, start_time=START_TIME))

    def _begin(self, world: World) -> None:
        self.world, self._taken = world, -1
        self._jammed = np.zeros(HAND.finger_count, dtype=bool)
        self._controller = ArmController(HOME_ARM)
        self.arm_state = world.arm_state()

    @property
    def time(self) -> float:
        """Simulated time [s]; never goes back, not even by a reset."""
        return self.world.time

    @property
    def program_running(self) -> bool:
        """Whether the arm takes commands."""
        return not self.faults.on("emergency_stop")

    @property
    def safety_mode(self) -> int:
        """As the UR driver numbers them: 1 normal, 3 protective stop, 7 emergency stop of the robot."""
        if self.faults.on("emergency_stop"):
            return 7
        return 3 if self.faults.on("protective_stop") else 1

    @property
    def speed_scaling(self) -> float:
        """Share of the planned speed, 0..1."""
        return self._controller.speed_scaling

    def close(self) -> None:
        """End a running goal and free the world."""
        self._controller.abort(FollowCode.INVALID_GOAL, "the simulation ends")
        self.world.close()

    # any thread

    def request(self, action: Callable[[], None]) -> None:
        """Have an action run between two steps, in the simulation's thread."""
        self._requests.put(action)

    def start_goal(self, goal: ArmGoal) -> None:
        """Follow a trajectory."""
        self.request(lambda: self._controller.start(goal, self.arm_state, self.time))

    def cancel_goal(self, goal: ArmGoal) -> None:
        """Stop following it."""
        self.request(lambda: self._controller.cancel(goal))

    def inject(self, fault: str, target: str, duration: float) -> None:
        """Switch a checked fault on."""
        self.request(lambda: self.faults.inject(fault, target, duration, self.time))

    def reset(self, objects: Sequence[PlacedObject], done: Callable[[], None] = lambda: None) -> None:
        """Start over with a new scene, arm and hand at their start; `done` is called when it stands."""
        self.request(lambda: self._reset(objects, done))

    # the simulation's thread

    def step(self) -> None:
        """One physics step with everything that belongs to it."""
        for _ in range(self._requests.qsize()):
            self._requests.get()()
        self._apply_faults()
        command = self._bus.command()
        if command.sequence != self._taken:
            self._taken = command.sequence
            self.world.hand.take(command)
        set_point = self._controller.step(PHYSICS.time_step, self.arm_state)
        self.world.arm.command(set_point.positions, set_point.velocities)
        self.world.step()
        self.arm_state = self.world.arm_state()
        if self.time >= self._next_hand_state:
            self._next_hand_state += STATE_PERIOD
            self._bus.publish_state(*self.world.hand.state(), self.world.hand.fingertip_forces(), self.time)

    def _apply_faults(self) -> None:
        self.faults.expire(self.time)
        if self._controller.busy and not self.program_running:
            self._controller.abort(FollowCode.INVALID_GOAL, "the robot's program does not run")
        self._controller.speed_scaling = 1.0 if self.safety_mode == 1 else 0.0
        if self._controller.busy and self.faults.take("abort_arm_goal"):
            self._controller.abort(FollowCode.INVALID_GOAL, "aborted by the injected fault abort_arm_goal")
        jammed = self.faults.jammed
        if np.any(jammed != self._jammed):
            self._jammed = jammed
            self.world.hand.jam(jammed)

    def _reset(self, objects: Sequence[PlacedObject], done: Callable[[], None]) -> None:
        self._controller.abort(FollowCode.INVALID_GOAL, "the simulated scene was reset")
        before = self.world
        self._begin(World(objects, start_time=self.time))
        # The open hand does not close again as the last command said, unless its driver goes on saying it.
        self._taken = self._bus.command().sequence
        before.close()
        done()


class Pacer:
    """Keeps simulated time at a multiple of wall time; what is lost is not caught up."""

    def __init__(self, factor: float) -> None:
        """Simulated seconds per second; 0 = as fast as possible."""
        self._factor = factor
        self._wall, self._simulated = time.monotonic(), -np.inf
        self._measured_wall, self._measured_simulated = self._wall, -np.inf

    def delay(self, simulated: float) -> float:
        """How long to sleep now [s], given the simulated time [s]."""
        now = time.monotonic()
        if self._factor <= 0:
            return 0.0
        due = self._wall + (simulated - self._simulated) / self._factor
        if not np.isfinite(due) or now > due + 0.1:
            self._wall, self._simulated = now, simulated
            return 0.0
        return max(due - now, 0.0)

    def measure(self, simulated: float) -> float:
        """Simulated seconds per second since the last call; 0 at the first."""
        now = time.monotonic()
        factor = (simulated - self._measured_simulated) / max(now - self._measured_wall, 1e-9)
        self._measured_wall, self._measured_simulated = now, simulated
        return float(factor) if np.isfinite(factor) else 0.0
