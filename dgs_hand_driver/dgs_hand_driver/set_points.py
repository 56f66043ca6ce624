"""From a command to joint set points, one control period after the other.

A hand's firmware does this, or the driver for a hand whose firmware goes to positions and nothing else.
"""

from __future__ import annotations

import numpy as np

from dgs_description.frames import Array
from dgs_hand_driver.admittance import AdmittanceController
from dgs_hand_driver.hand_state import HandCommand


class SetPoints:
    """Runs one command after the other.

    Attributes:
        command: that is being carried out.
        joints: (J,) set point [rad].
    """

    def __init__(self, joints: Array) -> None:
        """Stay at the joints (J,) [rad]."""
        self.command = HandCommand(target=joints)
        self.joints = joints.copy()
        self._admittance: AdmittanceController | None = None

    def take(self, command: HandCommand, measured: Array) -> None:
        """Begin a new command from the measured joints (J,) [rad]."""
        self.command, self.joints, self._admittance = command, measured, None
        if command.mode == "admittance":
            self._admittance = AdmittanceController(measured, command.target, command.active, command.speed)

    def step(self, torque: Array, dt: float) -> Array:
        """The set point (J,) [rad] after `dt` [s]; `torque` (J,): of the drives, positive in closing direction [Nm]."""
        if self._admittance is not None:
            self.joints = self._admittance.step(-torque, dt)
        elif self.command.mode == "hold":
            self.joints = self.command.target
        else:
            reach = self.command.speed * dt
            self.joints = self.joints + np.clip(self.command.target - self.joints, -reach, reach)
        return self.joints

    def stay_near(self, measured: Array, lead: Array) -> Array:
        """The set point (J,), now ahead of the measured joints (J,) by at most `lead` (J,) [rad]."""
        self.joints = np.clip(self.joints, measured - lead, measured + lead)
        if self._admittance is not None:
            self._admittance.position = self.joints
        return self.joints
