"""Grasps for one cloud without ROS: in `base_link` with extrinsics, else on the table that the cloud shows."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import BASE_LINK, CAMERA_OPTICAL, CELL, apply, inverse
from dgs_description.grasp import PlanRequest, Prediction
from dgs_description.table_fit import TablePlane, estimate_table, table_frame
from dgs_grasp_planner.cell_planner import Planner, in_workspace, why_none

Array = NDArray[np.float64]

HALF_EXTENT = 0.42
"""Half the edge of the square on an estimated table that is looked at: what the network was trained on [m]."""
HEIGHT = 0.30
"""Height of the volume that is looked at [m]."""
WORKSPACE_MARGIN = 0.03
"""Points farther outside of the cell's workspace are ignored [m]."""


@dataclass(frozen=True)
class OfflineAnswer:
    """Grasps and where they are.

    Attributes:
        frame: in which everything below is given.
        prediction: grasps in `frame`; none if `error` says why.
        T_frame_table: (4, 4) the frame *table* [m].
        T_frame_camera: (4, 4) the camera's optical frame [m].
        plane: the estimated table, None with extrinsics.
        points: (N, 3) float32 points that were looked at, in `frame` [m].
        rows: (N,) which rows of the input they are.
        error: NO_GRASP with its sentence, or None.
    """

    frame: str
    prediction: Prediction
    T_frame_table: Array
    T_frame_camera: Array
    plane: TablePlane | None
    points: NDArray[np.float32]
    rows: NDArray[np.int64]
    error: DgsError | None = None


def predict_on_estimated_table(
    planner: Planner, points: NDArray[np.float32], seed: int, request: PlanRequest
) -> OfflineAnswer:
    """Grasps in the camera's optical frame.

    Args:
        planner: works in the frame *table*.
        points: (N, 3) finite points in the camera's optical frame [m].
        seed: the same seed and cloud give the same answer.
        request: wishes.

    Raises:
        DgsError: CLOUD_NO_TABLE, CLOUD_EMPTY, NO_OBJECTS.
    """
    plane = estimate_table(points, np.random.default_rng([seed, 1]))
    T_camera_table = table_frame(plane, points)
    local = apply(inverse(T_camera_table), points.astype(np.float64))
    inside = (np.abs(local[:, :2]) < HALF_EXTENT).all(axis=1) & (local[:, 2] > -0.02) & (local[:, 2] < HEIGHT)
    frames = (CAMERA_OPTICAL, T_camera_table, np.eye(4))
    return _predict(planner, points, np.flatnonzero(inside), frames, plane, seed, request)


def predict_in_cell(
    planner: Planner, points: NDArray, T_base_camera: Array, seed: int, request: PlanRequest
) -> OfflineAnswer:
    """Grasps in `base_link`, inside the cell's workspace: what the planner node would answer.

    Args:
        planner: works in the frame *table*.
        points: (N, 3) finite points in `base_link` [m].
        T_base_camera: (4, 4) pose of the camera's optical frame.
        seed: the same seed and cloud give the same answer.
        request: wishes.

    Raises:
        DgsError: NO_OBJECTS.
    """
    rows = np.flatnonzero(in_workspace(points, WORKSPACE_MARGIN))
    if len(rows) == 0:
        raise DgsError(
            ErrorCode.NO_OBJECTS,
            f"none of the {len(points)} points lies in the workspace: check the camera's extrinsics",
        )
    frames = (BASE_LINK, CELL.T_base_table, T_base_camera)
    return _predict(planner, points, rows, frames, None, seed, request)


def _predict(
    planner: Planner,
    points: NDArray,
    rows: NDArray[np.int64],
    frames: tuple[str, Array, Array],
    plane: TablePlane | None,
    seed: int,
    request: PlanRequest,
) -> OfflineAnswer:
    frame, T_frame_table, T_frame_camera = frames
    T_table_frame = inverse(T_frame_table)
    seen = np.asarray(points[rows], dtype=np.float64)
    camera = apply(T_table_frame, T_frame_camera[None, :3, 3])[0]
    cloud = apply(T_table_frame, seen).astype(np.float32)
    prediction = planner(cloud, camera, np.random.default_rng(seed), request)
    error = None if len(prediction.grasps) else DgsError(ErrorCode.NO_GRASP, why_none(prediction, request))
    moved = replace(prediction, grasps=prediction.grasps.moved(T_frame_table))
    return OfflineAnswer(
        frame, moved, T_frame_table, T_frame_camera, plane, seen.astype(np.float32), rows, error
    )
