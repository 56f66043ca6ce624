"""Grasps for one cloud without ROS: in `base_link` where the camera stands as in the cell, else on the table seen."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dgs_description.cell import CELL
from dgs_description.cloud import voxel_means
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import BASE_LINK, CAMERA_OPTICAL, OBJECT_HEIGHT, Array, apply, inverse
from dgs_description.table_fit import TablePlane, estimate_table, table_frame
from dgs_grasp_planner.cell_planner import in_workspace, predict_on_table, why_none
from dgs_grasp_planner.scene import Planner, PlanRequest, Prediction
from dgs_grasp_planner.surroundings import VOXEL, things_on_table
from dgs_learning.training.views import ViewSettings

HALF_EXTENT, _, HEIGHT = ViewSettings.crop
"""Half the edge, and the height, of what is looked at on an estimated table: what the network was trained on [m]."""


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
        plane: the estimated table, None in the cell.
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


def answer_on_estimated_table(
    planner: Planner,
    points: NDArray[np.float32],
    seed: int,
    request: PlanRequest,
    masked: NDArray[np.bool_] | None = None,
) -> OfflineAnswer:
    """Grasps of the things on the table, in the camera's optical frame.

    Args:
        planner: works in the frame *table*.
        points: (N, 3) finite points in the camera's optical frame [m].
        seed: the same seed and cloud give the same answer.
        masked: (N,) which points may be grasped; None = those of `things_on_table`.

    Raises:
        DgsError: CLOUD_NO_TABLE, CLOUD_EMPTY, NO_OBJECTS.
    """
    plane = estimate_table(points, np.random.default_rng([seed, 1]))
    things = masked
    if masked is None:
        anywhere = table_frame(plane, points)
        things = things_on_table(apply(inverse(anywhere), points.astype(np.float64)), anywhere)
    T_camera_table = table_frame(plane, points, things)
    local = apply(inverse(T_camera_table), points.astype(np.float64))
    inside = (np.abs(local[:, :2]) < HALF_EXTENT).all(axis=1) & (local[:, 2] > -0.02) & (local[:, 2] < HEIGHT)
    answer = _predict(planner, points, inside, T_camera_table, np.eye(4), seed, request, things)
    return replace(answer, frame=CAMERA_OPTICAL, plane=plane)


def answer_in_cell(
    planner: Planner,
    points: NDArray,
    T_base_camera: Array,
    seed: int,
    request: PlanRequest,
    masked: NDArray[np.bool_] | None = None,
) -> OfflineAnswer:
    """Grasps in `base_link`, inside the cell's workspace: what the planner node would answer, but for pushes, and for
    what sticks out over the table's edge.

    Args:
        points: (N, 3) finite points in `base_link` [m].
        T_base_camera: (4, 4) pose of the camera's optical frame.
        masked: (N,) which points may be grasped; None = all.

    Raises:
        DgsError: CLOUD_NO_TABLE, NO_OBJECTS.
    """
    inside = in_workspace(points)
    return _predict(planner, points, inside, CELL.T_base_table, T_base_camera, seed, request, masked)


def _predict(
    planner: Planner,
    points: NDArray,
    inside: NDArray[np.bool_],
    T_frame_table: Array,
    T_frame_camera: Array,
    seed: int,
    request: PlanRequest,
    things: NDArray[np.bool_] | None,
) -> OfflineAnswer:
    rows = np.flatnonzero(inside)
    seen = np.asarray(points[rows], dtype=np.float64)
    if things is not None:
        wanted = apply(inverse(T_frame_table), seen[things[rows]])
        wanted = wanted[wanted[:, 2] > OBJECT_HEIGHT]
        if not len(wanted):
            raise DgsError(
                ErrorCode.NO_OBJECTS,
                "the mask marks nothing that stands on the table: mark the things' pixels",
            )
        request = replace(request, things=voxel_means(wanted, VOXEL))
    prediction = predict_on_table(planner, seen, T_frame_camera[:3, 3], T_frame_table, seed, request)
    # What moves something else is no grasp, and the answer has no place for its motion.
    prediction = replace(prediction, grasps=prediction.grasps[prediction.grasps.holds])
    none = None if len(prediction.grasps) else DgsError(ErrorCode.NO_GRASP, why_none(prediction, request))
    kept = seen.astype(np.float32)
    return OfflineAnswer(prediction, T_frame_table, T_frame_camera, kept, rows, BASE_LINK, None, none)
