"""The simulated hand's firmware: moves the joints as the commands on the bus say, with torque limits and jams."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from dgs_description.frames import Array
from dgs_description.hand import HAND
from dgs_description.hand_model import JOINTS_PER_FINGER
from dgs_hand_driver.hand_state import HandCommand
from dgs_hand_driver.set_points import SetPoints
from dgs_sim_bridge.world.physics import HandController

_JAM_TORQUE = 20.0
"""How much stronger than its motor a stuck gear is."""


class HandDrive:
    """Runs one `HandCommand` after the other on a `HandController`, one control period per physics step."""

    def __init__(self, controller: HandController, joints: ArrayLike) -> None:
        """Put the joints (J,) [rad] where they are to start, in position mode."""
        self._controller = controller
        self._points = SetPoints(np.asarray(joints, float).reshape(HAND.joint_count))
        self._jammed = np.zeros(HAND.finger_count, dtype=bool)
        self._jam_joints = self._points.joints.copy()
        controller.reset(self._points.joints)

    def take(self, command: HandCommand) -> None:
        """Begin a new command from the measured joints."""
        self._points.take(command, self._controller.state()[0])

    def jam(self, fingers: ArrayLike) -> None:
        """Block fingers (F,) bool where they are now; none = all free again."""
        fingers = np.asarray(fingers, dtype=bool).reshape(HAND.finger_count)
        fresh = np.repeat(fingers & ~self._jammed, JOINTS_PER_FINGER)
        self._jam_joints = np.where(fresh, self._controller.state()[0], self._jam_joints)
        if self._jammed.any() and self._points.command.mode == "admittance":
            self.take(self._points.command)  # or the freed finger would jump to where the spring has gone
        self._jammed = fingers

    def step(self, dt: float) -> None:
        """One control period [s]; call it before every physics step."""
        jammed = np.repeat(self._jammed, JOINTS_PER_FINGER)
        set_point = self._points.step(np.where(jammed, 0.0, self._controller.state()[2]), dt)
        wanted = np.where(jammed, self._jam_joints, set_point)
        self._controller.command(wanted, force_scale=np.where(jammed, _JAM_TORQUE, 1.0))

    def state(self) -> tuple[Array, Array]:
        """(J,) measured joints [rad] and (J,) drive torques, positive in closing direction [Nm]."""
        positions, _, torques = self._controller.state()
        # The motor of a jammed joint pushes against the gear until its limit, wherever the set point is.
        pushing = np.clip((self._points.command.target - positions) * 20.0, -HAND.effort, HAND.effort)
        return positions, np.where(np.repeat(self._jammed, JOINTS_PER_FINGER), pushing, torques)

    def fingertip_forces(self) -> Array:
        """(F, 2) normal and tangential force on the fingertips [N]."""
        return self._controller.fingertip_forces()
