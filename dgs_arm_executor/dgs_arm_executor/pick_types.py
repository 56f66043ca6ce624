"""What the pick planner takes and gives: candidates, rejections, a whole planned pick."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from dgs_arm_executor.obstacle_cloud import CarriedBox
from dgs_arm_executor.paths import PathSettings
from dgs_arm_executor.timing import Trajectory
from dgs_description.errors import ErrorCode
from dgs_description.frames import CELL, Cell, transform
from dgs_description.hand_model import YAW_SPREAD

Array = NDArray[np.float64]

HOME = np.deg2rad([-100.0, -110.0, 100.0, -80.0, -90.0, 0.0])
"""Default home posture [rad]: hand beside the bin, no part of the arm between camera and workspace."""
OPEN_HAND = np.stack([YAW_SPREAD, *np.zeros((3, 5))], axis=1).reshape(20)
"""Straight fingers, fanned out so that neighbours do not touch and what sticks between them falls out [rad]."""

STAGES = ("escape", "transfer", "approach", "lift", "carry", "home")
"""Arm motions of a pick in order; `escape` is there only when the arm starts inside the observed cloud."""


@dataclass(frozen=True)
class Candidate:
    """One grasp to choose from.

    Attributes:
        index: position in the list of the goal.
        T_base_tcp: (4, 4) pose of `hand_tcp` at the grasp.
        pre_grasp_joints, grasp_joints: (20,) [rad].
        reference_point: (3,) point on the target in `base_link` [m].
        score: larger is better.
    """

    index: int
    T_base_tcp: Array
    pre_grasp_joints: Array
    grasp_joints: Array
    reference_point: Array
    score: float = 0.0


def candidates_of(
    position: Array,
    rotation: Array,
    pre_grasp_joints: Array,
    grasp_joints: Array,
    reference_point: Array,
    score: Array,
) -> tuple[Candidate, ...]:
    """Candidates from K grasps in `base_link`, in their order.

    Args:
        position: (K, 3) of `hand_tcp` [m].
        rotation: (K, 3, 3).
        pre_grasp_joints, grasp_joints: (K, 20) [rad].
        reference_point: (K, 3) [m].
        score: (K,).
    """
    rows = zip(position, rotation, pre_grasp_joints, grasp_joints, reference_point, score, strict=True)
    return tuple(
        Candidate(k, transform(turn, place), before, final, reference, float(value))
        for k, (place, turn, before, final, reference, value) in enumerate(rows)
    )


@dataclass(frozen=True)
class Rejection:
    """Why a candidate was not taken."""

    index: int
    code: ErrorCode
    reason: str


@dataclass(frozen=True)
class Load:
    """What the hand holds.

    Attributes:
        box: around it; None where nothing is known of it.
        grasp: what it was gripped with; None where nobody knows.
    """

    box: CarriedBox | None = None
    grasp: Candidate | None = None


@dataclass(frozen=True)
class PickPlan:
    """Everything the arm will do, planned before it moves.

    Attributes:
        candidate: the chosen grasp.
        trajectories: by stage name of `STAGES`; `carry` and `home` are missing when the object is to be kept.
        stand_off, grasp: (6,) arm joints [rad].
        load: what the hand will hold after the lift.
    """

    candidate: Candidate
    trajectories: dict[str, Trajectory]
    stand_off: Array
    grasp: Array
    load: Load = Load()

    @property
    def duration(self) -> float:
        """Time that the arm moves [s]."""
        return sum(trajectory.duration for trajectory in self.trajectories.values())


@dataclass(frozen=True)
class PickAnswer:
    """Answer of the planner: a plan or None, and why better-scored candidates were refused."""

    plan: PickPlan | None
    rejections: tuple[Rejection, ...]
    seconds: float


@dataclass(frozen=True)
class PickSettings:
    """Geometry, speeds and time limits of a pick."""

    home: tuple[float, ...] = field(default_factory=lambda: tuple(HOME.tolist()))
    """Arm joints [rad]."""
    stand_off: float = 0.10
    """Back along the TCP's z [m]."""
    lift: float = 0.15
    """Straight up [m]."""
    release_clearance: float = 0.05
    """Between the bin's rim and the lowest known point of the object [m]."""
    speed: float = 0.6
    """Share of the joint velocity limits for transfer and home."""
    carry_speed: float = 0.4
    approach_speed: float = 0.15
    """Of the TCP [m/s]."""
    lift_speed: float = 0.15
    """Of the TCP [m/s]."""
    rate: float = 50.0
    """Trajectory points per second [Hz]."""
    time_limit: float = 10.0
    """For the whole planning [s]."""
    sampled_goals: int = 2
    """So many IK branches per candidate, and release states per branch, get the sampling planner."""
    release_tries: int = 24
    """So many states over the bin are looked at, nearest first."""
    path: PathSettings = field(default_factory=lambda: PathSettings(timeout=0.6))
    cell: Cell = CELL
