"""dgs_interfaces/PredictGrasps <-> core types: checks of a request, contents of a reply."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
from dgs_interfaces.msg import TargetRegion
from dgs_interfaces.srv import PredictGrasps
from geometry_msgs.msg import PointStamped, Pose, PoseStamped
from std_msgs.msg import Header

from dgs_description.cell import CELL
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frame_tree import FrameTree
from dgs_description.frames import BASE_LINK, Array, apply, inverse
from dgs_description.words import plural
from dgs_grasp_planner.scene import PlanRequest, Prediction, Region
from dgs_ros.grasp_msgs import grasps_to_msgs, stage_times_to_msgs
from dgs_ros.pose_msgs import pose_to_matrix, to_array

MAX_GRASPS = 256
_LARGEST_BOX, _MOST_BOXES = 2.0, 32
"""Edge [m] and number of keep-out boxes."""


def brings_cloud(request: PredictGrasps.Request) -> bool:
    """Whether the request has a cloud of its own; one with a frame but no points counts, it is an empty cloud."""
    cloud = request.cloud
    return len(cloud.data) > 0 or cloud.header.frame_id != "" or cloud.width * cloud.height > 0


def read_request(request: PredictGrasps.Request, frames: FrameTree) -> PlanRequest:
    """The wishes of a request.

    Raises:
        DgsError: REQUEST_INVALID (max_grasps, min_score, too many failed grasps), or REGION_INVALID (frame, pose or
            size of a region, a target point, a keep-out box, a failed grasp).
    """
    if request.max_grasps > MAX_GRASPS:
        raise DgsError(
            ErrorCode.REQUEST_INVALID,
            f"max_grasps is {request.max_grasps}, it must be at most {MAX_GRASPS} (0 = default)",
        )
    if not (math.isfinite(request.min_score) and 0.0 <= request.min_score <= 1.0):
        raise DgsError(
            ErrorCode.REQUEST_INVALID,
            f"min_score is {request.min_score}, it must lie in [0, 1] (0 = default)",
        )
    return PlanRequest(
        max_grasps=int(request.max_grasps) or None,
        min_score=float(request.min_score) or None,
        region=_read_region(request.target_region, frames, "the target region"),
        targets=_read_targets(request.target_points, frames),
        keep_out=tuple(_read_keep_out(request.keep_out, frames)),
        failed=_read_failed(request.failed, frames),
    )


def _read_failed(poses: Sequence[PoseStamped], frames: FrameTree) -> Array:
    """(F, 4, 4) in the table frame [m]."""
    if len(poses) > MAX_GRASPS:
        raise DgsError(
            ErrorCode.REQUEST_INVALID, f"{len(poses)} failed grasps; at most {MAX_GRASPS} are allowed"
        )
    failed = np.empty((len(poses), 4, 4))
    for k, msg in enumerate(poses):
        T_table_frame = _frame(msg.header.frame_id, frames, f"failed grasp {k}")
        failed[k] = T_table_frame @ _pose(msg.pose, f"failed grasp {k}")
    return failed


def _frame(name: str, frames: FrameTree, what: str) -> Array:
    """T_table_frame of the frame that something is given in."""
    T_base_frame = frames.pose(name)
    if T_base_frame is None:
        unknown = f"frame '{name}' of {what} is unknown; known is {BASE_LINK} and /tf_static"
        raise DgsError(ErrorCode.REGION_INVALID, unknown)
    return inverse(CELL.T_base_table) @ T_base_frame


def _pose(msg: Pose, what: str) -> Array:
    try:
        return pose_to_matrix(msg)
    except DgsError as error:
        raise DgsError(ErrorCode.REGION_INVALID, f"{what}: {error.message}") from error


def _read_targets(points: Sequence[PointStamped], frames: FrameTree) -> Array | None:
    """(M, 3) in the table frame [m]; None = there are none."""
    targets = []
    for k, msg in enumerate(points):
        T_table_frame = _frame(msg.header.frame_id, frames, f"target point {k}")
        point = to_array(msg.point)
        if not np.isfinite(point).all():
            raise DgsError(
                ErrorCode.REGION_INVALID, f"target point {k} is {point.tolist()}; it must be finite"
            )
        targets.append(apply(T_table_frame, point))
    return np.array(targets) if targets else None


def _read_keep_out(boxes: Sequence[TargetRegion], frames: FrameTree) -> Iterator[Region]:
    if len(boxes) > _MOST_BOXES:
        raise DgsError(
            ErrorCode.REGION_INVALID, f"{len(boxes)} keep-out boxes; at most {_MOST_BOXES} are allowed"
        )
    for k, msg in enumerate(boxes):
        region = _read_region(msg, frames, f"keep-out box {k}")
        if region is None:
            raise DgsError(ErrorCode.REGION_INVALID, f"keep-out box {k} names no frame")
        if region.size.max() > _LARGEST_BOX:
            large = f"keep-out box {k} is {region.size.max():.1f} m long"
            raise DgsError(ErrorCode.REGION_INVALID, f"{large}; {_LARGEST_BOX:g} m are enough for any table")
        yield region


def _read_region(msg: TargetRegion, frames: FrameTree, what: str) -> Region | None:
    frame = msg.header.frame_id
    if not frame:
        return None
    T_table_frame = _frame(frame, frames, what)
    size = to_array(msg.size)
    if not (np.isfinite(size).all() and (size > 0).all()):
        raise DgsError(
            ErrorCode.REGION_INVALID, f"size {size.tolist()} of {what} must be positive in x, y, z"
        )
    return Region(T_table_frame @ _pose(msg.center, f"centre of {what}"), size)


def fill_success(response: PredictGrasps.Response, prediction: Prediction, cloud_header: Header) -> None:
    """Put a prediction in `base_link` into a reply."""
    response.error_code = int(ErrorCode.SUCCESS)
    response.message = plural(len(prediction.grasps), "grasp")
    response.header = Header(stamp=cloud_header.stamp, frame_id=BASE_LINK)
    response.grasps = grasps_to_msgs(prediction.grasps)
    response.points_used = prediction.points_used
    response.stage_times = stage_times_to_msgs(prediction.stage_times)


def fill_error(response: PredictGrasps.Response, error: DgsError) -> None:
    """Put an error into a reply."""
    response.error_code = int(error.code)
    response.message = error.message
