"""Grasps for one cloud without ROS: in `base_link` with extrinsics, else on the table that the cloud shows."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import BASE_LINK, CAMERA_OPTICAL, CELL, apply, inverse
from dgs_grasp_planner.cell_planner import CellPlanner, Planner, why_none
from dgs_grasp_planner.grasp import PlanRequest, Prediction
from dgs_grasp_planner.table_plane import TablePlane, camera_in_table, estimate_table, table_frame

Array = NDArray[np.float64]

HALF_EXTENT = 0.42
"""Half the edge of the square on an estimated table that is looked at: what the network was trained on [m]."""
HEIGHT = 0.30
"""Height of the volume that is looked at [m]."""


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
    cloud = apply(inverse(T_camera_table), points.astype(np.float64)).astype(np.float32)
    inside = (np.abs(cloud[:, :2]) < HALF_EXTENT).all(axis=1) & (cloud[:, 2] > -0.02) & (cloud[:, 2] < HEIGHT)
    rows = np.flatnonzero(inside)
    prediction = planner(cloud[rows], camera_in_table(T_camera_table), np.random.default_rng(seed), request)
    error = None if len(prediction.grasps) else DgsError(ErrorCode.NO_GRASP, why_none(prediction, request))
    moved = replace(prediction, grasps=prediction.grasps.moved(T_camera_table))
    return OfflineAnswer(CAMERA_OPTICAL, moved, T_camera_table, np.eye(4), plane, points[rows], rows, error)


def predict_in_cell(
    planner: Planner,
    points: NDArray[np.float32],
    T_base_camera: Array,
    seed: int,
    request: PlanRequest,
    points_frame: str = CAMERA_OPTICAL,
) -> OfflineAnswer:
    """Grasps in `base_link`, inside the cell's workspace: what the planner node would answer.

    Args:
        planner: works in the frame *table*.
        points: (N, 3) finite points [m].
        T_base_camera: (4, 4) pose of the camera's optical frame.
        seed: the same seed and cloud give the same answer.
        request: wishes.
        points_frame: frame of the points, the camera's optical frame or `base_link`.

    Raises:
        DgsError: NO_OBJECTS.
    """
    T_base_points = np.eye(4) if points_frame == BASE_LINK else T_base_camera
    base = apply(T_base_points, points.astype(np.float64))
    cell = CellPlanner(lambda: planner)
    try:
        prediction, error = cell.predict(base, T_base_camera[:3, 3], seed, request), None
    except DgsError as caught:
        if caught.code != ErrorCode.NO_GRASP:
            raise
        prediction, error = Prediction.none(), caught
    low, high = CELL.workspace_bounds
    rows = np.flatnonzero(((base >= low) & (base <= high)).all(axis=1))
    shown = base[rows].astype(np.float32)
    return OfflineAnswer(BASE_LINK, prediction, CELL.T_base_table, T_base_camera, None, shown, rows, error)
