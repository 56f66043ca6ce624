"""One depth image or cloud in, one clean cloud in `base_link` out; shared by all sources."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dgs_description.camera import MILLIMETRE, PinholeCamera
from dgs_description.cell import CELL, Cell
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import BASE_LINK, CAMERA_LINK, Array
from dgs_perception.edges import clean_points
from dgs_perception.frames_median import FramesMedian
from dgs_perception.workspace import Cropped, crop


@dataclass(frozen=True, eq=False)
class CloudPipeline:
    """Deprojection, transform and crop for one camera.

    Depth images are calmed over frames where `median` is given, and flying pixels set right with `edges`.
    """

    cell: Cell = CELL
    edges: bool = False
    median: FramesMedian | None = None

    def from_depth(
        self, depth: NDArray, camera: PinholeCamera, frame_id: str, depth_unit: float = MILLIMETRE
    ) -> Cropped:
        """The cloud of a depth image (H, W) as for `PinholeCamera.all_points`; returns as `crop`.

        Raises:
            DgsError: EXTRINSICS_INVALID when `frame_id` is not the optical frame whose pose is known (an image that
                was aligned to the colour camera would be shifted by 59 mm); DEPTH_FORMAT or CAMERA_INFO_INVALID.
        """
        if frame_id.strip("/") != self.cell.optical_frame:
            raise self._unknown_frame("depth image", frame_id, [self.cell.optical_frame])
        points = camera.all_points(depth, depth_unit)
        if self.median is not None:
            points = camera.all_points(self.median(points[:, 2].reshape(depth.shape)))
        if self.edges:
            clean_points(points, camera)
        return crop(points, self.cell.T_base_camera_optical, *self.cell.cloud_bounds)

    def from_cloud(self, points: NDArray[np.floating], frame_id: str) -> Cropped:
        """`crop` of (N, 3) points [m] in `base_link` or a camera frame. Raises EXTRINSICS_INVALID."""
        poses: dict[str, Array] = {
            BASE_LINK: np.eye(4),
            CAMERA_LINK: self.cell.T_base_camera_link,
            self.cell.optical_frame: self.cell.T_base_camera_optical,
        }
        T_base_cloud = poses.get(frame_id.strip("/"))
        if T_base_cloud is None:
            raise self._unknown_frame("cloud", frame_id, list(poses))
        return crop(points, T_base_cloud, *self.cell.cloud_bounds)

    def _unknown_frame(self, what: str, frame_id: str, known: list[str]) -> DgsError:
        where = f"The {what} is in the frame {frame_id!r}, whose pose is not known"
        return DgsError(ErrorCode.EXTRINSICS_INVALID, f"{where}; known: {', '.join(known)}.")
