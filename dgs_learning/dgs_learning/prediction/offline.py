"""Grasps for one cloud without ROS: in `base_link` with extrinsics, else on the table that the cloud shows."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import BASE_LINK, CAMERA_OPTICAL, CELL, Array, apply, inverse
from dgs_description.table_fit import TablePlane, estimate_table, table_frame
from dgs_grasp_planner.cell_planner import in_workspace, predict_on_table, why_none
from dgs_grasp_planner.scene import Planner, PlanRequest, Prediction

HALF_EXTENT = 0.42
"""Half the edge of the square on an estimated table that is looked at: what the network was trained on [m]."""
HEIGHT = 0.30
"""Height of the volume that is looked at [m]."""


@dataclass(frozen=True)
class OfflineAnswer:
    """Grasps and where they are.

    Attributes:
        prediction: grasps in `frame`; none if `error` says why.
        T_frame_table: (4, 4) the frame *table* [m].
        T_frame_camera: (4, 4) the camera's optical frame [m].
        points: (N, 3) float32 points that were looked at, in `frame` [m].
        rows: (N,) which rows of the input they are.
        frame: in which everything is given.
        plane: the estimated table, None with extrinsics.
        error: NO_GRASP with its sentence, or None.
    """

    prediction: Prediction
    T_frame_table: Array
    T_frame_camera: Array
    points: NDArray[np.float32]
    rows: NDArray[np.int64]
    frame: str
    plane: TablePlane | None
    error: DgsError | None


def predict_on_estimated_table(
    planner: Planner, points: NDArray[np.float32], seed: int, request: PlanRequest
) -> OfflineAnswer:
    """Grasps in the camera's optical frame.

    Args:
        planner: works in the frame *table*.
        points: (N, 3) finite points in the camera's optical frame [m].
        seed: the same seed and cloud give the same answer.

    Raises:
        DgsError: CLOUD_NO_TABLE, CLOUD_EMPTY, NO_OBJECTS.
    """
    plane = estimate_table(points, np.random.default_rng([seed, 1]))
    T_camera_table = table_frame(plane, points)
    local = apply(inverse(T_camera_table), points.astype(np.float64))
    inside = (np.abs(local[:, :2]) < HALF_EXTENT).all(axis=1) & (local[:, 2] > -0.02) & (local[:, 2] < HEIGHT)
    answer = _predict(planner, points, inside, T_camera_table, np.eye(4), seed, request)
    return replace(answer, frame=CAMERA_OPTICAL, plane=plane)


def predict_in_cell(
    planner: Planner, points: NDArray, T_base_camera: Array, seed: int, request: PlanRequest
) -> OfflineAnswer:
    """Grasps in `base_link`, inside the cell's workspace: what the planner node would answer.

    Args:
        points: (N, 3) finite points in `base_link` [m].
        T_base_camera: (4, 4) pose of the camera's optical frame.

    Raises:
        DgsError: NO_OBJECTS.
    """
    return _predict(planner, points, in_workspace(points), CELL.T_base_table, T_base_camera, seed, request)


def _predict(
    planner: Planner,
    points: NDArray,
    inside: NDArray[np.bool_],
    T_frame_table: Array,
    T_frame_camera: Array,
    seed: int,
    request: PlanRequest,
) -> OfflineAnswer:
    rows = np.flatnonzero(inside)
    seen = np.asarray(points[rows], dtype=np.float64)
    prediction = predict_on_table(planner, seen, T_frame_camera[:3, 3], T_frame_table, seed, request)
    none = None if len(prediction.grasps) else DgsError(ErrorCode.NO_GRASP, why_none(prediction, request))
    kept = seen.astype(np.float32)
    return OfflineAnswer(prediction, T_frame_table, T_frame_camera, kept, rows, BASE_LINK, None, none)
