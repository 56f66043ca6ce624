"""What was tried in vain in a run, kept where the things lie now."""

from __future__ import annotations

import numpy as np

from dgs_description.frames import Array
from dgs_description.grasp import GraspSet

_REACH = 0.1
"""What failed so near to the middle of a thing that is pushed, failed on it [m]."""
_SAME = 0.05
"""What failed so near to a grasp that held, failed on the thing that is gone now [m]."""


class FailedGrasps:
    """Remembers grasps that failed, for the next request.

    Attributes:
        poses: (F, 4, 4) of `hand_tcp`, in the frame of the grasps.
    """

    def __init__(self) -> None:
        self.poses: Array = np.zeros((0, 4, 4))

    def note(self, grasp: GraspSet, success: bool) -> None:
        """Take note of one executed grasp, or of a push: with success it takes along what failed on its thing."""
        # A hand that moves begins far from its thing.
        stays = grasp.holds and not np.any(grasp.motion)
        place = grasp.position if stays else grasp.reference_point
        away = np.linalg.norm(self.poses[:, :2, 3] - place[:2], axis=1)
        if not grasp.holds:
            self.poses[away < _REACH, :3, 3] += grasp.motion * success
        elif success:
            self.poses = self.poses[away >= _SAME]
        else:
            self.poses = np.concatenate([self.poses, grasp.pose[None]])
