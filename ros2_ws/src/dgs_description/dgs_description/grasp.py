"""Core data types: a set of whole grasps as arrays, what is asked of a planner, and what it answers."""

from __future__ import annotations

from dataclasses import dataclass, field, fields

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class GraspSet:
    """K grasps in one frame, best score first.

    Attributes:
        position: (K, 3) TCP [m].
        rotation: (K, 3, 3) axes of `hand_tcp`.
        pre_grasp_joints: (K, 20) [rad], order of `HAND_JOINTS`.
        grasp_joints: (K, 20) [rad].
        score: (K,) in [0, 1], descending.
        reference_point: (K, 3) cloud point that each grasp belongs to [m].
        offset: (K, 3) position - reference_point [m].
        proposed: (K,) from geometry (`level_pinch`), not from the network; none unless said.
    """

    position: Array
    rotation: Array
    pre_grasp_joints: Array
    grasp_joints: Array
    score: Array
    reference_point: Array
    offset: Array
    proposed: NDArray[np.bool_] = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        """Nothing said of `proposed` means none."""
        if self.proposed is None:
            object.__setattr__(self, "proposed", np.zeros(len(self.score), dtype=bool))

    def __len__(self) -> int:
        return int(self.score.shape[0])

    def select(self, index: ArrayLike) -> GraspSet:
        """The grasps of an index array, a slice's indices or a mask, in that order."""
        chosen = np.asarray(index)
        return GraspSet(**{f.name: getattr(self, f.name)[chosen] for f in fields(self)})

    def moved(self, T_a_b: Array) -> GraspSet:
        """The same grasps in frame a; `T_a_b` is the (4, 4) pose of their frame b in a."""
        turn, shift = T_a_b[:3, :3], T_a_b[:3, 3]
        return GraspSet(
            position=self.position @ turn.T + shift,
            rotation=turn @ self.rotation,
            pre_grasp_joints=self.pre_grasp_joints,
            grasp_joints=self.grasp_joints,
            score=self.score,
            reference_point=self.reference_point @ turn.T + shift,
            offset=self.offset @ turn.T,
            proposed=self.proposed,
        )

    def joined(self, other: GraspSet) -> GraspSet:
        """These grasps, then those of another set in the same frame."""
        return GraspSet(
            **{f.name: np.concatenate([getattr(self, f.name), getattr(other, f.name)]) for f in fields(self)}
        )

    @classmethod
    def empty(cls) -> GraspSet:
        """No grasps."""
        return cls(
            np.zeros((0, 3)),
            np.zeros((0, 3, 3)),
            np.zeros((0, 20)),
            np.zeros((0, 20)),
            np.zeros(0),
            np.zeros((0, 3)),
            np.zeros((0, 3)),
        )


@dataclass(frozen=True)
class Region:
    """A box outside of which nothing is grasped.

    Attributes:
        T_table_box: (4, 4) pose of the box's centre in the table frame.
        size: (3,) edge lengths [m].
    """

    T_table_box: Array
    size: Array

    def contains(self, points: Array) -> NDArray[np.bool_]:
        """(N,) which of the points (N, 3) [m], table frame, lie inside."""
        local = (points - self.T_table_box[:3, 3]) @ self.T_table_box[:3, :3]
        return np.asarray((np.abs(local) <= self.size / 2).all(axis=1))


@dataclass(frozen=True)
class PlanRequest:
    """What a caller may wish besides the cloud; None = the planner's default."""

    max_grasps: int | None = None
    min_score: float | None = None
    region: Region | None = None

    def admitted(self, grasps: GraspSet) -> GraspSet:
        """Those grasps (table frame) whose score and reference point are as wished."""
        good = np.ones(len(grasps), dtype=bool)
        if self.min_score is not None:
            good &= grasps.score >= self.min_score
        if self.region is not None:
            good &= self.region.contains(grasps.reference_point)
        return grasps.select(np.flatnonzero(good))


NO_WISHES = PlanRequest()


@dataclass(frozen=True)
class Prediction:
    """A planner's answer.

    Attributes:
        grasps: in the table frame, checked.
        points_used: points given to the network.
        stage_times: seconds per stage, and `total`.
        rejected: number of candidates per reason of rejection.
    """

    grasps: GraspSet
    points_used: int
    stage_times: dict[str, float]
    rejected: dict[str, int] = field(default_factory=dict)
