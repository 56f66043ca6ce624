"""The suite's only grasp type: a set of whole grasps as arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dgs_description.frames import Array, transform


@dataclass(frozen=True, kw_only=True)
class GraspSet:
    """K grasps in one frame. Indexed with a number it is one grasp: its arrays have no axis K.

    Attributes:
        position: (K, 3) TCP [m].
        rotation: (K, 3, 3) axes of `hand_tcp`.
        pre_grasp_joints: (K, 20) [rad], order of `HAND_JOINTS`.
        grasp_joints: (K, 20) [rad].
        active_fingers: (K, 5) bool, order of `FINGERS`: who closes; the others keep their shape.
        score: (K,) larger is better; a proposer's own lie in [0, 1].
        reference_point: (K, 3) cloud point that each grasp belongs to [m].
        source: (K,) name of the proposer.
        quality: (K,) in [0, 1] of the contacts; 1 unless the contact stage said otherwise.
    """

    position: Array
    rotation: Array
    pre_grasp_joints: Array
    grasp_joints: Array
    active_fingers: NDArray[np.bool_]
    score: Array
    reference_point: Array
    source: NDArray[np.str_]
    quality: Array

    @property
    def offset(self) -> Array:
        """(K, 3) position - reference_point [m] (sigma of the paper)."""
        return self.position - self.reference_point

    @property
    def pose(self) -> Array:
        """(K, 4, 4) of `hand_tcp` in the grasps' frame."""
        return transform(self.rotation, self.position)

    def __len__(self) -> int:
        return len(self.position)

    def __getitem__(self, index: Any) -> GraspSet:
        """One grasp of a number; those of an index array, a slice or a mask, in that order."""
        return GraspSet(**{f.name: getattr(self, f.name)[index] for f in fields(self)})

    def moved(self, T_a_b: Array) -> GraspSet:
        """The same grasps in frame a; `T_a_b` is the (4, 4) pose of their frame b in a."""
        turn, shift = T_a_b[:3, :3], T_a_b[:3, 3]
        values = {f.name: getattr(self, f.name) for f in fields(self)} | {
            "position": self.position @ turn.T + shift,
            "rotation": turn @ self.rotation,
            "reference_point": self.reference_point @ turn.T + shift,
        }
        return GraspSet(**values)

    def best_first(self) -> GraspSet:
        """By falling score; equals keep their order."""
        return self[np.argsort(-self.score, kind="stable")]

    @classmethod
    def of(
        cls,
        source: str,
        *,
        position: ArrayLike,
        rotation: ArrayLike,
        pre_grasp_joints: ArrayLike,
        grasp_joints: ArrayLike,
        active_fingers: ArrayLike,
        score: ArrayLike,
        reference_point: ArrayLike,
    ) -> GraspSet:
        """K grasps of one proposer; joints may come as (K, 5, 4), active fingers as (5,) for all.

        Raises:
            ValueError: an array has another shape.
        """
        place = np.asarray(position, np.float64).reshape(-1, 3)
        count = len(place)
        return cls(
            position=place,
            rotation=np.asarray(rotation, np.float64).reshape(count, 3, 3),
            pre_grasp_joints=np.asarray(pre_grasp_joints, np.float64).reshape(count, 20),
            grasp_joints=np.asarray(grasp_joints, np.float64).reshape(count, 20),
            active_fingers=np.broadcast_to(np.asarray(active_fingers, bool), (count, 5)),
            score=np.asarray(score, np.float64).reshape(count),
            reference_point=np.asarray(reference_point, np.float64).reshape(count, 3),
            source=np.full(count, source),
            quality=np.ones(count),
        )

    @classmethod
    def empty(cls) -> GraspSet:
        """No grasps."""
        none = np.zeros(0)
        return cls.of(
            "",
            position=none,
            rotation=none,
            pre_grasp_joints=none,
            grasp_joints=none,
            active_fingers=np.zeros((0, 5), bool),
            score=none,
            reference_point=none,
        )


def joined(sets: Sequence[GraspSet]) -> GraspSet:
    """The grasps of several sets in one frame, one set after the other."""
    if not sets:
        return GraspSet.empty()
    return GraspSet(
        **{f.name: np.concatenate([getattr(each, f.name) for each in sets]) for f in fields(GraspSet)}
    )
