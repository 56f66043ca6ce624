"""A hand with simple joints on a real bus: what the tests of the driver move."""

from __future__ import annotations

import threading
from dataclasses import dataclass, field
from typing import Self

import numpy as np

from dgs_description.joints import HAND_EFFORT, HAND_JOINTS
from dgs_hand_driver.admittance import AdmittanceController
from dgs_sim_bridge.hand.virtual_hand import HandCommand, VirtualHand

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
    """

    port: int = 0
    walls: dict[str, float] = field(default_factory=dict)
    slowness: float = 1.0
    silent: bool = False
    time_step: float = 0.02
    wall_period: float = 0.005

    def __post_init__(self) -> None:
        self.bus_end = VirtualHand(port=self.port)
        self.positions = np.zeros(20)
        self._torques = np.zeros(20)
        self._controller = AdmittanceController()
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
                self.bus_end.publish_state(self.positions, self._torques, self._clock)

    def _step(self, command: HandCommand) -> None:
        wall = np.array([self.walls.get(name, np.inf) for name in HAND_JOINTS])
        speed = command.speed / self.slowness
        if command.mode == "admittance":
            if command.sequence != self._seen:
                self._controller.start(self.positions, command.target, command.active, speed)
            # Small steps: a stiff wall on a coarse one would bounce.
            for _ in range(20):
                depth = np.maximum(self._controller.position - wall, 0.0)
                self._controller.step(-WALL_STIFFNESS * depth, self.time_step / 20)
            self.positions = self._controller.position.copy()
            self._torques = np.minimum(WALL_STIFFNESS * np.maximum(self.positions - wall, 0.0), HAND_EFFORT)
        else:
            step = speed * self.time_step
            wanted = self.positions + np.clip(command.target - self.positions, -step, step)
            self.positions = np.minimum(wanted, wall)
            # A drive that is stopped pushes as hard as it can; one that has arrived does not.
            self._torques = np.where(command.target > wall + 1e-3, HAND_EFFORT, 0.0)
        self._seen = command.sequence
