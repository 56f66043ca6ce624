"""The planner in base_link: workspace, frames, sentences of refusals."""

from __future__ import annotations

import re

import numpy as np
import pytest

from dgs_description.cell import CELL
from dgs_description.errors import ErrorCode
from dgs_description.frames import apply, transform
from dgs_description.grasp import GraspSet
from dgs_grasp_planner.cell_planner import in_workspace, predict_in_cell, why_none
from dgs_grasp_planner.load import planner_with
from dgs_grasp_planner.planner import GraspPlanner
from dgs_grasp_planner.propose.dgs_net import DgsNet
from dgs_grasp_planner.scene import PlanRequest, Prediction, Region
from tests.dgs_grasp_planner.models import eager_network, eager_planner
from tests.dgs_grasp_planner.scenes import CAMERA, table_scene
from tests.support.refused import refused

CAMERA_BASE = apply(CELL.T_base_table, CAMERA[None])[0]


def _in_base(points: np.ndarray) -> np.ndarray:
    return apply(CELL.T_base_table, points.astype(np.float64))


@pytest.fixture(scope="module")
def cell() -> GraspPlanner:
    return eager_planner()


def test_grasps_come_back_in_base_link(cell: GraspPlanner) -> None:
    prediction = predict_in_cell(cell, _in_base(table_scene(1)), CAMERA_BASE, 3, PlanRequest())
    grasps = prediction.grasps
    low, high = CELL.workspace_bounds
    assert len(grasps) > 0
    assert ((grasps.reference_point > low - 0.05) & (grasps.reference_point < high + 0.05)).all()
    direct = eager_planner()(table_scene(1), CAMERA, np.random.default_rng(3)).grasps
    np.testing.assert_allclose(
        grasps.moved(np.linalg.inv(CELL.T_base_table)).position, direct.position, atol=1e-4
    )


def test_points_outside_of_the_workspace_do_not_count(cell: GraspPlanner) -> None:
    scene = _in_base(table_scene(1))
    outside = np.concatenate([scene, _in_base(table_scene(2)) + (2.0, 0.0, 0.0)])
    a, b = (predict_in_cell(cell, points, CAMERA_BASE, 3, PlanRequest()) for points in (scene, outside))
    assert a.points_used == b.points_used
    for points in (scene + (2.0, 0.0, 0.0), 1000 * scene):
        with refused(ErrorCode.CLOUD_NO_TABLE, "lies in the workspace.*in metres"):
            predict_in_cell(cell, points, CAMERA_BASE, 3, PlanRequest())


@pytest.mark.parametrize("side", [(1, 0), (0, 1), (0, -1)])
def test_what_lies_at_the_border_of_the_workspace_is_seen_whole_but_not_the_bin(
    side: tuple[int, int],
) -> None:
    half = np.array(CELL.workspace_size) / 2
    near, far = (CELL.T_base_table[:3, 3] + (*(np.array(side) * (half + off)), 0.02) for off in (0.08, 0.15))
    bin_wall = np.array([*CELL.bin_centre, CELL.table_height + 0.1]) + (CELL.bin_size[0] / 2, 0.1, 0.0)
    assert in_workspace(np.array([near, far, bin_wall])).tolist() == [True, False, False]


def test_what_sticks_out_over_the_edge_beside_the_robot_is_seen_where_that_edge_is_free() -> None:
    (x, _, _), (low, high) = CELL.cloud_bounds[0], CELL.free_edge
    z = CELL.table_height + 0.05
    places = np.array(
        [[x + 0.01, (low + high) / 2, z], [x + 0.01, low - 0.01, z], [x - 0.01, high - 0.01, z]]
    )
    inside = np.array([0.3, 0.0, z])
    assert in_workspace(np.vstack([inside, places])).tolist() == [True, True, False, False]


def test_what_towers_in_the_bin_is_done_with_and_what_stands_beside_it_is_not() -> None:
    rim = CELL.table_height + CELL.bin_size[2]
    beside = np.array([CELL.bin_centre[0] + CELL.bin_size[0] / 2 + 0.03, CELL.bin_centre[1], 0.0])
    heap, hanging, low = (beside + (0.0, 0.0, rim + off) for off in (0.05, -0.02, -0.05))
    farther = heap + (0.04, 0.0, 0.0)
    assert in_workspace(np.array([heap, hanging, low, farther])).tolist() == [False, False, True, True]


def test_where_nothing_was_proposed_nothing_is_said_of_candidates() -> None:
    nothing = Prediction(GraspSet.empty(), 900, {}, {"UNLIKELY": 0})
    assert why_none(nothing, PlanRequest()).startswith("no point scored high enough")
    here = PlanRequest(region=Region(np.eye(4), np.ones(3)))
    assert why_none(nothing, here).startswith("no point in the target region scored high enough")


def test_no_grasp_says_why() -> None:
    cell = planner_with(DgsNet(eager_network()), ["dgs_net"])
    flat = table_scene(1)
    flat[:, 2] = np.where(flat[:, 2] > 0.01, 0.014, flat[:, 2])
    with refused(ErrorCode.NO_GRASP, "TABLE_AT_GRASP"):
        predict_in_cell(cell, _in_base(flat), CAMERA_BASE, 3, PlanRequest())


@pytest.mark.parametrize("aimed", [False, True])
def test_boxes_in_which_nothing_is_left_are_named(cell: GraspPlanner, aimed: bool) -> None:
    scene = table_scene(1)
    top = scene[np.argmax(scene[:, 2])][None].astype(np.float64)
    everything, nowhere = (Region(transform(position=(x, 0.0, 0.0)), np.full(3, 2.0)) for x in (0.0, 9.0))
    outside, inside = "outside of the keep_out boxes", "in the target region"
    for boxes, place in (
        ({"keep_out": (everything,)}, outside),
        ({"region": nowhere}, inside),
        ({"region": nowhere, "keep_out": (everything,)}, f"{inside} and {outside}"),
    ):
        request = PlanRequest(targets=top if aimed else None, **boxes)
        objects = "the objects at the target points" if aimed else "an object"
        with refused(ErrorCode.NO_GRASP, f"^no point of {objects} lies {place}: check the boxes"):
            predict_in_cell(cell, _in_base(scene), CAMERA_BASE, 3, request)


def test_what_is_too_wide_is_said_with_its_width_where_it_is_wanted(cell: GraspPlanner) -> None:
    rng = np.random.default_rng(0)
    case = rng.uniform((-0.09, -0.07, 0.02), (0.09, 0.07, 0.02), (6000, 3))
    points = _in_base(np.concatenate([table_scene(objects=0), case]))
    with refused(ErrorCode.NO_GRASP) as error:
        predict_in_cell(cell, points, CAMERA_BASE, 3, PlanRequest())
    width = re.search(r"too wide for the hand's 88 mm: (\d+) mm$", error.value.message)
    assert width and 135 <= int(width[1]) <= 155, error.value.message
    post = rng.uniform((0.0, 0.2, 0.06), (0.03, 0.23, 0.06), (500, 3))
    with refused(ErrorCode.NO_GRASP, "take another view$"):
        aimed = PlanRequest(targets=post[:1])
        without_edge = planner_with(None, ["edge_pinch"])
        predict_in_cell(without_edge, np.concatenate([points, _in_base(post)]), CAMERA_BASE, 3, aimed)
