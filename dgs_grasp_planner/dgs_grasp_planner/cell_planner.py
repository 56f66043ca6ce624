"""The planner as a cell uses it: clouds and grasps in `base_link`, cropped to the workspace."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dgs_description.cell import CELL
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import Array, apply, inverse
from dgs_description.hand import HAND
from dgs_grasp_planner.scene import Planner, PlanRequest, Prediction

WORKSPACE_MARGIN = 0.03
"""Points farther outside of the workspace are ignored [m]."""
PILE = 0.06, 0.03
"""What is no farther beside the bin, and no farther below its rim or above it, lies on what is in the bin [m]."""


def in_workspace(points_base: Array, margin: float = WORKSPACE_MARGIN) -> NDArray[np.bool_]:
    """(N,) which points (N, 3) [m], `base_link`, lie in the workspace, widened by `margin` [m] towards the robot.

    On the other sides it is as wide as clouds are: things are seen whole. Where the table's edge beside the robot is
    free, those between the workspace and `OVERHANG` beyond the edge lie in it, too. What towers in the bin is
    done with.

    Raises:
        DgsError: CLOUD_NO_TABLE; none does.
    """
    near, (low, high), (free_low, free_high) = CELL.workspace_bounds[0][0], CELL.cloud_bounds, CELL.free_edge
    boxes = (
        (np.array([near - margin, *low[1:]]), high),
        (np.array([low[0], free_low, low[2]]), np.array([near, free_high, high[2]])),
    )
    inside = np.zeros(len(points_base), bool)
    for a, b in boxes:  # column by column: an eighth of the time of all at once
        inside |= np.logical_and.reduce(
            [(column >= a[k]) & (column <= b[k]) for k, column in enumerate(points_base.T)]
        )
    (beside, below), rim = PILE, CELL.table_height + CELL.bin_size[2]
    off = [np.abs(points_base[:, k] - CELL.bin_centre[k]) - CELL.bin_size[k] / 2 > beside for k in (0, 1)]
    inside &= off[0] | off[1] | (points_base[:, 2] < rim - below)
    if not inside.any():
        raise DgsError(
            ErrorCode.CLOUD_NO_TABLE,
            f"none of the {len(points_base)} points lies in the workspace: check the camera's pose, and that the "
            "cloud is in metres",
        )
    return inside


def predict_on_table(
    planner: Planner, points: Array, camera: ArrayLike, T_frame_table: Array, seed: int, request: PlanRequest
) -> Prediction:
    """Grasps in the frame that the points are in.

    Args:
        planner: works in the frame *table*.
        points: (N, 3) finite points [m].
        camera: (3,) its position [m].
        T_frame_table: (4, 4) where the table is.
        seed: the same seed and cloud give the same answer.
        request: wishes.
    """
    T_table_frame = inverse(T_frame_table)
    seen_from = apply(T_table_frame, np.asarray(camera, np.float64)[None])[0]
    cloud = apply(T_table_frame, points).astype(np.float32)
    prediction = planner(cloud, seen_from, np.random.default_rng(seed), request)
    return replace(prediction, grasps=prediction.grasps.moved(T_frame_table))


def predict_in_cell(
    planner: Planner, points_base: Array, camera_base: ArrayLike, seed: int, request: PlanRequest
) -> Prediction:
    """Grasps in `base_link`.

    Args:
        planner: works in the frame *table*.
        points_base: (N, 3) finite points [m].
        camera_base: (3,) camera position [m].
        seed: the same seed and cloud give the same answer.
        request: wishes; a region in the table frame.

    Raises:
        DgsError: CLOUD_NO_TABLE, NO_OBJECTS, NO_GRASP (with what was rejected and why).
    """
    points = points_base[in_workspace(points_base)]
    prediction = predict_on_table(planner, points, camera_base, CELL.T_base_table, seed, request)
    if len(prediction.grasps) == 0:
        raise DgsError(ErrorCode.NO_GRASP, why_none(prediction, request))
    return prediction


def why_none(prediction: Prediction, request: PlanRequest) -> str:
    """The sentence that goes with NO_GRASP."""
    places = ["in the target region"] * (request.region is not None)
    places += ["outside of the keep_out boxes"] * bool(request.keep_out)
    if places and not prediction.wanted:
        objects = "an object" if request.targets is None else "the objects at the target points"
        return f"no point of {objects} lies {' and '.join(places)}: check the boxes and their frames"
    widths = ", ".join(f"{1e3 * width:.0f} mm" for width in prediction.too_wide)
    wide = f"; too wide for the hand's {1e3 * HAND.grasp.widest:.0f} mm: {widths}" if widths else ""
    reasons = {name: count for name, count in prediction.rejected.items() if count}
    if not reasons:
        where = "" if request.region is None else " in the target region"
        return f"no point{where} scored high enough for a grasp: lower min_score or take another view{wide}"
    why = ", ".join(f"{name} {count}" for name, count in reasons.items())
    return (
        f"all {sum(reasons.values())} candidates would collide, miss or slip ({why}): take another view{wide}"
    )
