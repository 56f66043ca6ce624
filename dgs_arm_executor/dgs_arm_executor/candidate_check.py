"""Whether a candidate grasp is one at all: finite numbers, a rotation, hand joints within their limits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dgs_arm_executor.pick_types import Candidate
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.joints import HAND_LOWER, HAND_UPPER

_LIMIT_TOLERANCE = 0.02
"""Hand joints this far outside of their limits are clipped, not refused [rad]."""


def check_candidate(candidate: Candidate) -> Candidate:
    """The candidate with its joints clipped to the limits.

    Raises:
        DgsError: GRASP_INVALID if a number is not finite, the rotation is none or a joint is far out of its limits.
    """
    values = (
        candidate.T_base_tcp,
        candidate.pre_grasp_joints,
        candidate.grasp_joints,
        candidate.reference_point,
    )
    if not all(np.isfinite(value).all() for value in values):
        raise DgsError(ErrorCode.GRASP_INVALID, "the grasp holds numbers that are not finite")
    rotation = candidate.T_base_tcp[:3, :3]
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-3 or np.linalg.det(rotation) < 0:
        raise DgsError(ErrorCode.GRASP_INVALID, "the grasp's orientation is not a rotation")
    shapes = []
    for name, joints in (("pre-grasp", candidate.pre_grasp_joints), ("grasp", candidate.grasp_joints)):
        excess = np.maximum(HAND_LOWER - joints, joints - HAND_UPPER).max()
        if excess > _LIMIT_TOLERANCE:
            raise DgsError(
                ErrorCode.GRASP_INVALID, f"a hand joint of the {name} is {excess:.3f} rad beyond its limit"
            )
        shapes.append(np.clip(joints, HAND_LOWER, HAND_UPPER))
    return replace(candidate, pre_grasp_joints=shapes[0], grasp_joints=shapes[1])
