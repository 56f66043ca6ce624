"""The suite's only grasp type: a set of whole grasps as arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dgs_description.frames import Array, transform
from dgs_description.hand import HAND


@dataclass(frozen=True, kw_only=True)
class GraspSet:
    """K grasps in one frame. Indexed with a number it is one grasp: its arrays have no axis K.

    Attributes:
        position: (K, 3) TCP [m].
        rotation: (K, 3, 3) axes of `hand_tcp`.
        pre_grasp_joints: (K, J) [rad], order of `HAND.joints`.
        grasp_joints: (K, J) [rad].
        active_fingers: (K, F) bool, order of `HAND.fingers`: who closes; the others keep their shape.
        score: (K,) larger is better; a proposer's own lie in [0, 1].
        reference_point: (K, 3) cloud point that each grasp belongs to [m].
        source: (K,) name of the proposer.
        quality: (K,) in [0, 1] of the contacts; 1 unless the contact stage said otherwise.
        motion: (K, 3) straight way of the TCP after the approach, before closing [m]; zero unless said. A *push* is a
            motion with no active finger: nothing closes, nothing is lifted.
        drags: (K,) bool: the fingers close before the motion, and open after it; nothing is lifted.
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
    motion: Array
    drags: NDArray[np.bool_]

    @property
    def offset(self) -> Array:
        """(K, 3) position - reference_point [m] (sigma of the paper)."""
        return self.position - self.reference_point

    @property
    def pose(self) -> Array:
        """(K, 4, 4) of `hand_tcp` in the grasps' frame, where the approach ends."""
        return transform(self.rotation, self.position)

    @property
    def closing_pose(self) -> Array:
        """(K, 4, 4) of `hand_tcp` in the grasps' frame after the motion, where the fingers close, or a drag ends."""
        return transform(self.rotation, self.position + self.motion)

    @property
    def holds(self) -> NDArray[np.bool_]:
        """(K,) whether fingers close to lift something; else it is a push or a drag."""
        return np.asarray(self.active_fingers.any(axis=-1) & ~self.drags)

    def __len__(self) -> int:
        return len(self.position)

    def __getitem__(self, index: Any) -> GraspSet:
        """One grasp of a number; those of an index array, a slice or a mask, in that order."""
        return GraspSet(**{f.name: getattr(self, f.name)[index] for f in fields(self)})

    def moved(self, T_a_b: Array) -> GraspSet:
        """The same grasps in frame a; `T_a_b` is the (4, 4) pose of their frame b in a."""
        turn, shift = T_a_b[:3, :3], T_a_b[:3, 3]
        position, reference = (points @ turn.T + shift for points in (self.position, self.reference_point))
        return replace(
            self,
            position=position,
            rotation=turn @ self.rotation,
            reference_point=reference,
            motion=self.motion @ turn.T,
        )

    def best_first(self) -> GraspSet:
        """By falling score; equals keep their order."""
        return self[np.argsort(-self.score, kind="stable")]

    def apart(self, distance: float, most: int) -> GraspSet:
        """The `most` best whose TCPs are farther than `distance` [m] from one another, best first."""
        return self[non_maximum_suppression(self.position, self.score, distance, most)]

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
        score: ArrayLike = 1.0,
        reference_point: ArrayLike | None = None,
        motion: ArrayLike = 0.0,
        drags: bool = False,
    ) -> GraspSet:
        """K grasps of one proposer.

        Joints may come as (K, F, 4), active fingers as (F,), score and motion as a number for all. Without a
        reference point it is the TCP.

        Raises:
            ValueError: an array has another shape.
        """
        place = np.asarray(position, np.float64).reshape(-1, 3)
        count, reference = len(place), place if reference_point is None else reference_point
        return cls(
            position=place,
            rotation=np.asarray(rotation, np.float64).reshape(count, 3, 3),
            pre_grasp_joints=np.asarray(pre_grasp_joints, np.float64).reshape(count, HAND.joint_count),
            grasp_joints=np.asarray(grasp_joints, np.float64).reshape(count, HAND.joint_count),
            active_fingers=np.broadcast_to(np.asarray(active_fingers, bool), (count, HAND.finger_count)),
            score=np.broadcast_to(np.asarray(score, np.float64), count).copy(),
            reference_point=np.asarray(reference, np.float64).reshape(count, 3),
            source=np.full(count, source),
            quality=np.ones(count),
            motion=np.broadcast_to(np.asarray(motion, np.float64), (count, 3)).copy(),
            drags=np.full(count, drags),
        )

    @classmethod
    def empty(cls) -> GraspSet:
        """No grasps."""
        return cls.of(
            "", position=(), rotation=(), pre_grasp_joints=(), grasp_joints=(), active_fingers=False
        )


def non_maximum_suppression(points: Array, score: Array, radius: float, limit: int) -> NDArray[np.int64]:
    """Greedy: take the best point, drop all within `radius` of it, repeat.

    Args:
        points: (N, 3) [m].
        score: (N,).
        radius: [m].

    Returns:
        (M,) indices, best first. Equal scores are taken in the order of the points.
    """
    order = np.argsort(-score, kind="stable")
    remaining = points.T.take(order, axis=1)
    kept: list[np.int64] = []
    while len(order) and len(kept) < limit:
        kept.append(order[0])
        far = ((remaining - remaining[:, :1]) ** 2).sum(axis=0) > radius * radius
        order, remaining = order.compress(far), remaining.compress(far, axis=1)
    return np.array(kept, dtype=np.int64)


def joined(sets: Sequence[GraspSet]) -> GraspSet:
    """The grasps of several sets in one frame, one set after the other."""
    if not sets:
        return GraspSet.empty()
    names = [f.name for f in fields(GraspSet)]
    return GraspSet(**{name: np.concatenate([getattr(each, name) for each in sets]) for name in names})
