"""One carried hand and rigid objects, in free space or on a table: the same in every physics engine."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from dgs_description.frames import Array
from dgs_description.grasp import GraspSet
from dgs_description.hand import HAND
from dgs_hand_driver.admittance import AdmittanceController
from dgs_sim_bridge.render.object_model import ObjectModel

CARRIER_FORCE = 400.0
"""Largest force that carries the hand [N]: stiff, as an arm is."""


@dataclass(frozen=True)
class Wear:
    """What use has done to a hand; a new one by default.

    Attributes:
        zeros: (J,) error of the joints' zeros: what is measured minus what is true [rad].
        backlash: play between motor and joint [rad].
        delay: of a command [s].
        effort: share of the torque limits that is left.
    """

    zeros: Array = field(default_factory=lambda: np.zeros(HAND.joint_count))
    backlash: float = 0.0
    delay: float = 0.0
    effort: float = 1.0


class HandWorld(ABC):
    """One hand and its objects; use as a context manager.

    The hand is held in its joints until `start_closing`; from then on it complies. Frame: the table's, else the
    world's. Engines implement the physics; what the hand's electronics do stands here.

    Attributes:
        models: of the objects, by index.
        period: control period, the time of one `step` [s].
        left: indices of the objects that are still there.
    """

    period: float

    def __init__(self, models: Sequence[ObjectModel], wear: Wear | None):
        self.models = list(models)
        self.left = list(range(len(self.models)))
        self._wear = wear or Wear()
        self._admittance: AdmittanceController | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:  # noqa: B027
        """Free what the engine holds."""

    @abstractmethod
    def object_pose(self, index: int) -> Array:
        """(4, 4) pose of an object."""

    @abstractmethod
    def place(self, index: int, T_world_object: Array) -> None:
        """Put an object there, at rest."""

    @abstractmethod
    def _vanish(self, index: int) -> None: ...

    @abstractmethod
    def hand_pose(self) -> Array:
        """(4, 4) pose of the TCP."""

    @abstractmethod
    def carry(self, T_world_tcp: Array) -> None:
        """Where the arm, limited to `CARRIER_FORCE`, pulls the hand: a pose of the orientation it was put in."""

    @abstractmethod
    def _put(self, T_world_tcp: Array, joints: Array) -> None: ...

    @abstractmethod
    def _command(self, joints: Array) -> None: ...

    @abstractmethod
    def _state(self) -> tuple[Array, Array]: ...

    @abstractmethod
    def contacts(self, index: int) -> set[int]:
        """Fingers, by number, that touch an object."""

    @abstractmethod
    def set_gravity(self, vector: ArrayLike) -> None:
        """(3,) gravity from now on [m/s^2]."""

    @abstractmethod
    def set_friction(self, value: float) -> None:
        """Friction of the hand, from now on, on an object with coefficient 1."""

    @abstractmethod
    def _advance(self) -> None:
        """Let one period pass."""

    def object_poses(self) -> dict[int, Array]:
        """(4, 4) pose of every object that is left."""
        return {index: self.object_pose(index) for index in self.left}

    def remove(self, index: int) -> None:
        """Take an object away."""
        self.left.remove(index)
        self._vanish(index)

    def put_hand(self, T_world_tcp: Array, joints: Array) -> None:
        """Place the hand at rest, its joints (J,) as measured [rad]."""
        self._admittance = None
        self._put(T_world_tcp, joints - self._wear.zeros)

    def posture(self) -> Array:
        """(J,) joints as they are, whatever is measured [rad]."""
        return self._state()[0]

    def joints(self) -> tuple[Array, Array]:
        """(J,) measured joints [rad] and (J,) motor torques, positive in closing direction [Nm]."""
        positions, torques = self._state()
        return positions + self._wear.zeros, torques

    def start_closing(self, grasp: GraspSet, speed: float) -> None:
        """Begin to close on one grasp under admittance control, with at most `speed` [rad/s]."""
        start = self.joints()[0]
        self._admittance = AdmittanceController(start, grasp.grasp_joints, grasp.active_fingers, speed)
        self._motor = start.copy()
        late = round(self._wear.delay / self.period)
        self._queue: deque[Array] = deque([start] * late, maxlen=late + 1)

    def step(self) -> None:
        """One control period."""
        if self._admittance is not None:
            self._queue.append(self._admittance.step(-self.joints()[1], self.period))
            # A joint with play follows its motor only once the motor has crossed the play.
            half = self._wear.backlash / 2
            self._motor = np.clip(self._motor, self._queue[0] - half, self._queue[0] + half)
            self._command(self._motor - self._wear.zeros)
        self._advance()
