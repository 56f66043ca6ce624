"""A hand with simple joints on a real bus: what the tests of the driver move."""

from __future__ import annotations

import threading
from dataclasses import dataclass, field
from typing import Self

import numpy as np

from dgs_description.frames import Array
from dgs_description.hand import HAND
from dgs_hand_driver.admittance import AdmittanceController
from dgs_hand_driver.hand_state import HandCommand
from dgs_sim_bridge.hand.virtual_hand import VirtualHand

WALL_STIFFNESS = 40.0
"""[Nm/rad]"""


@dataclass
class SimulatedHand:
    """Joints that follow the command at its speed, and walls that stop them. A context manager.

    Attributes:
        walls: joint name -> angle that it cannot pass in closing direction [rad].
        slowness: the joints move this many times slower than commanded.
        silent: no joint states; the heartbeat goes on.
        time_step: hand time per cycle [s].
        wall_period: wall time per cycle [s]; shorter than `time_step` makes the tests quick.
        stiffness: of a wall that a held set point is pushed into [Nm/rad]; infinite: the drive gives all it has.
        forces: (F, 2) normal and tangential force that the fingertips feel [N].
        cycles: that have passed.
    """

    port: int = 0
    walls: dict[str, float] = field(default_factory=dict)
    slowness: float = 1.0
    silent: bool = False
    time_step: float = 0.02
    wall_period: float = 0.005
    stiffness: float = np.inf
    forces: Array = field(default_factory=lambda: np.zeros((HAND.finger_count, 2)))
    cycles: int = 0

    def __post_init__(self) -> None:
        self.bus_end = VirtualHand(port=self.port)
        self.positions = np.zeros(HAND.joint_count)
        self._torques = np.zeros(HAND.joint_count)
        self._seen = 0
        self._clock = 0.0
        self._ended = threading.Event()

    def __enter__(self) -> Self:
        self.bus_end.start()
        self.port = self.bus_end.port
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._ended.set()
        self._thread.join()
        self.bus_end.stop()

    def _run(self) -> None:
        while not self._ended.wait(self.wall_period):
            self._step(self.bus_end.command())
            self._clock += self.time_step
            if not self.silent:
                self.bus_end.publish_state(self.positions, self._torques, self.forces, self._clock)
            self.cycles += 1

    def _step(self, command: HandCommand) -> None:
        wall = np.array([self.walls.get(name, np.inf) for name in HAND.joints])
        speed = command.speed / self.slowness
        if command.mode == "admittance":
            if command.sequence != self._seen:
                start = self.positions, command.target, command.active
                self._controller = AdmittanceController(*start, speed)
            # Small steps: a stiff wall on a coarse one would bounce.
            for _ in range(20):
                depth = np.maximum(self._controller.position - wall, 0.0)
                self._controller.step(-WALL_STIFFNESS * depth, self.time_step / 20)
            self.positions = self._controller.position.copy()
            self._torques = np.minimum(WALL_STIFFNESS * np.maximum(self.positions - wall, 0.0), HAND.effort)
        else:
            step = speed * self.time_step
            wanted = self.positions + np.clip(command.target - self.positions, -step, step)
            self.positions = np.minimum(wanted, wall)
            # A drive that is stopped pushes as hard as it can; one that has arrived does not.
            depth = np.maximum(command.target - wall - 1e-3, 0.0)
            self._torques = np.where(
                depth > 0, np.minimum(HAND.effort, self.stiffness * np.maximum(depth, 1e-9)), 0.0
            )
        self._seen = command.sequence
