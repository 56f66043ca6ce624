"""The simulated hand's firmware: moves the joints as the commands on the bus say, with torque limits and jams."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from dgs_description.frames import Array
from dgs_description.joints import HAND_EFFORT
from dgs_sim_bridge.hand.virtual_hand import HandCommand
from dgs_sim_bridge.world.physics import HandController

_JAM_TORQUE = 20.0
"""How much stronger than its motor a stuck gear is."""


class HandDrive:
    """Runs one `HandCommand` after the other on a `HandController`, one control period per physics step."""

    def __init__(self, controller: HandController, joints: ArrayLike) -> None:
        """Put the joints (20,) [rad] where they are to start, in position mode."""
        self._controller = controller
        self._command = HandCommand(target=np.asarray(joints, float).reshape(20))
        self._set_point = self._command.target.copy()
        self._jammed = np.zeros(5, dtype=bool)
        self._jam_joints = self._set_point.copy()
        controller.reset(self._set_point)

    def take(self, command: HandCommand) -> None:
        """Begin a new command from the measured joints."""
        self._command = command
        if command.mode == "admittance":
            self._controller.start_closing(command.target, command.active, command.speed)
        else:
            self._set_point = self._controller.state()[0]

    def jam(self, fingers: ArrayLike) -> None:
        """Block fingers (5,) bool where they are now; none = all free again."""
        fingers = np.asarray(fingers, dtype=bool).reshape(5)
        fresh = np.repeat(fingers & ~self._jammed, 4)
        self._jam_joints = np.where(fresh, self._controller.state()[0], self._jam_joints)
        if self._jammed.any() and self._command.mode == "admittance":
            self.take(self._command)  # or the freed finger would jump to where the spring has gone
        self._jammed = fingers

    def step(self, dt: float) -> None:
        """One control period [s]; call it before every physics step."""
        if self._command.mode == "admittance":
            torque = np.where(np.repeat(self._jammed, 4), 0.0, self._controller.state()[2])
            self._set_point = self._controller.admittance.step(-torque, dt)
        elif self._command.mode == "hold":
            self._set_point = self._command.target
        else:
            reach = self._command.speed * dt
            self._set_point = self._set_point + np.clip(self._command.target - self._set_point, -reach, reach)
        jammed = np.repeat(self._jammed, 4)
        wanted = np.where(jammed, self._jam_joints, self._set_point)
        self._controller.command(wanted, force_scale=np.where(jammed, _JAM_TORQUE, 1.0))

    def state(self) -> tuple[Array, Array]:
        """(20,) measured joints [rad] and (20,) drive torques, positive in closing direction [Nm]."""
        positions, _, torques = self._controller.state()
        # The motor of a jammed joint pushes against the gear until its limit, wherever the set point is.
        pushing = np.clip((self._command.target - positions) * 20.0, -HAND_EFFORT, HAND_EFFORT)
        return positions, np.where(np.repeat(self._jammed, 4), pushing, torques)
