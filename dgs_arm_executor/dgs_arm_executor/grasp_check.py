"""Whether a grasp is one at all: finite numbers, a rotation, hand joints within their limits, fingers that close."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dgs_description.errors import DgsError, ErrorCode
from dgs_description.grasp import GraspSet
from dgs_description.joints import HAND_LOWER, HAND_UPPER

Array = NDArray[np.float64]

_LIMIT_TOLERANCE = 0.02
"""Hand joints this far outside of their limits are clipped, not refused [rad]."""


def check_grasp(grasp: GraspSet) -> GraspSet:
    """One grasp with its joints clipped to the limits.

    Raises:
        DgsError: GRASP_INVALID if a number is not finite, the rotation is none, no finger takes part, or a joint is far
            out of its limits.
    """
    numbers = (grasp.pose, grasp.reference_point, grasp.pre_grasp_joints, grasp.grasp_joints)
    if not all(np.isfinite(values).all() for values in numbers):
        raise _invalid("the grasp holds numbers that are not finite")
    if (
        np.abs(grasp.rotation @ grasp.rotation.T - np.eye(3)).max() > 1e-3
        or np.linalg.det(grasp.rotation) < 0
    ):
        raise _invalid("the grasp's orientation is not a rotation")
    if not grasp.active_fingers.any():
        raise _invalid("the grasp's active_fingers name no finger that closes")
    return replace(
        grasp,
        pre_grasp_joints=_within_limits("pre-grasp", grasp.pre_grasp_joints),
        grasp_joints=_within_limits("grasp", grasp.grasp_joints),
    )


def _within_limits(shape: str, joints: Array) -> Array:
    excess = np.maximum(HAND_LOWER - joints, joints - HAND_UPPER).max()
    if excess > _LIMIT_TOLERANCE:
        raise _invalid(f"a hand joint of the {shape} is {excess:.3f} rad beyond its limit")
    return np.clip(joints, HAND_LOWER, HAND_UPPER)


def _invalid(what: str) -> DgsError:
    return DgsError(ErrorCode.GRASP_INVALID, what)
