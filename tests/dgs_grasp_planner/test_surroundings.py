"""Things on a table told from walls, robots and what hangs over the table's edge, in rendered views."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dgs_description.errors import ErrorCode
from dgs_description.frames import Array, apply, inverse, look_at, transform
from dgs_description.table_fit import estimate_table, table_frame
from dgs_grasp_planner.scene import PlanRequest, prepare
from dgs_grasp_planner.surroundings import things_on_table, walls
from dgs_sim_bridge.render.d455 import D455, D455Noise
from dgs_sim_bridge.render.object_model import find_catalogue
from dgs_sim_bridge.render.raster import Mesh, Rendering, box_mesh, render
from tests.support.refused import refused

TABLE = (box_mesh((-0.35, -0.5, -0.03), (0.35, 0.5, 0.0)), np.eye(4))
ROBOT = (box_mesh((-0.06, -0.06, 0.0), (0.06, 0.06, 0.6)), transform(position=(-0.25, 0.0, 0.0)))
PEDESTAL = (box_mesh((-0.06, -0.06, -0.5), (0.06, 0.06, 0.25)), transform(position=(-0.45, 0.1, 0.0)))
OVER_THE_EDGE = (box_mesh((-0.1, -0.03, 0.0), (0.1, 0.03, 0.06)), transform(position=(0.0, 0.52, 0.0)))
LOW_ARM = (box_mesh((-0.9, -0.4, 0.12), (-0.05, -0.32, 0.2)), np.eye(4))
WALL = (box_mesh((-0.5, -1.0, -0.5), (-0.38, 1.0, 1.0)), np.eye(4))
THINGS = (3, 20, 40, 60)


def _things() -> list[tuple[Mesh, Array]]:
    spots = ((0.1, -0.2), (0.0, 0.1), (0.15, 0.15), (0.2, 0.0))
    models = [find_catalogue("novel")[k] for k in THINGS]
    return [
        (model.mesh, transform(position=(*spot, -model.vertices[:, 2].min())))
        for model, spot in zip(models, spots, strict=True)
    ]


def _view(scene: list[tuple[Mesh, Array]], T_table_camera: Array) -> Rendering:
    meshes, poses = zip(*scene, strict=True)
    return render(meshes, poses, D455, T_table_camera)


def _seen(others: list[tuple[Mesh, Array]], T_table_camera: Array) -> tuple[np.ndarray, np.ndarray]:
    """Points (N, 3) in the optical frame, and which of them belong to `_things`."""
    view = _view([TABLE, *_things(), *others], T_table_camera)
    noise = D455Noise(smeared=0.0, dropped=0.0, edge_jitter=0.0, bias_rms=0.0)
    noisy = noise.apply(view.depth, D455, np.random.default_rng(0))
    ids = view.ids[noisy > 0]
    return D455.deproject(noisy), (ids > 0) & (ids <= len(THINGS))


@pytest.mark.parametrize("roll_deg", [0.0, 160.0])
@pytest.mark.parametrize(
    "others",
    [[], [ROBOT], [PEDESTAL], [OVER_THE_EDGE], [LOW_ARM], [WALL], [ROBOT, OVER_THE_EDGE, WALL]],
    ids=["nothing", "robot", "pedestal", "over the edge", "low arm", "wall", "all"],
)
def test_things_are_told_from_what_stands_around(others: list[tuple[Mesh, Array]], roll_deg: float) -> None:
    T_table_camera = look_at((0.75, 0.1, 0.75), (0.0, 0.0, 0.0))
    T_table_camera[:3, :3] @= Rotation.from_euler("z", roll_deg, degrees=True).as_matrix()
    points, thing = _seen(others, T_table_camera)
    T_camera_table = table_frame(estimate_table(points, np.random.default_rng(0)), points)
    local = apply(inverse(T_camera_table), points.astype(np.float64))
    found = things_on_table(local, T_camera_table)
    high = local[:, 2] > 0.012
    assert found[thing & high].mean() > 0.97
    assert (found & ~thing)[high].sum() < 0.03 * thing.sum()


@pytest.mark.parametrize("plate", [False, True], ids=["alone", "touching a plate over the edge"])
def test_things_that_touch_one_another_are_things(plate: bool) -> None:
    row = [
        (box_mesh((-0.1, y, 0.0), (-0.02, y + 0.08, 0.07)), np.eye(4)) for y in np.arange(-0.1, 0.45, 0.09)
    ]
    foot = [(box_mesh((-0.3, 0.45, 0.0), (0.2, 0.8, 0.05)), np.eye(4))] if plate else []
    T_table_camera = look_at((0.75, 0.1, 0.75), (0.0, 0.0, 0.0))
    view = _view([TABLE, *row, *foot], T_table_camera)
    points, ids = apply(T_table_camera, D455.deproject(view.depth).astype(float)), view.ids[view.depth > 0]
    found, high = things_on_table(points, inverse(T_table_camera)), points[:, 2] > 0.012
    whole = (ids > 0) & (ids <= len(row) - 2 * plate) & high
    assert np.ptp(points[whole, 1]) > 0.40, "longer together than one thing may be"
    assert found[whole].mean() > 0.97
    of_plate = (ids > len(row)) & high
    assert found[of_plate].sum() <= 0.1 * of_plate.sum()


def test_with_nothing_but_a_robot_nothing_can_be_grasped() -> None:
    T_table_camera = look_at((0.75, 0.1, 0.75), (0.0, 0.0, 0.0))
    points = D455.deproject(_view([TABLE, ROBOT], T_table_camera).depth)
    with refused(ErrorCode.NO_OBJECTS, "1 that stand there reach over its edge or are too large"):
        things_on_table(apply(T_table_camera, points.astype(float)), inverse(T_table_camera))


def test_wild_points_of_a_cloud_take_no_memory() -> None:
    T_table_camera = look_at((0.75, 0.1, 0.75), (0.0, 0.0, 0.0))
    points = apply(
        T_table_camera, D455.deproject(_view([TABLE, *_things()], T_table_camera).depth).astype(float)
    )
    wild = [(1e6, -1e6, 0.0), (-1e6, 1e6, 0.1), (1e7, 1e7, 1e7)]
    usual, found = (
        things_on_table(cloud, inverse(T_table_camera)) for cloud in (points, np.vstack([points, wild]))
    )
    assert usual.any()
    np.testing.assert_array_equal(found, [*usual, False, False, False])


def _wall(rng: np.random.Generator, length: float, height: float) -> np.ndarray:
    """(N, 3) a rough wall at x = -0.2 [m]."""
    count = int(length * height * 40_000)
    low, high = (-0.21, -length / 2, 0.0), (-0.19, length / 2, height)
    return rng.uniform(low, high, (count, 3))


CAMERA = np.array([0.7, 0.0, 0.7])


def test_a_wall_is_found_and_a_cereal_box_and_a_low_curb_are_none() -> None:
    rng = np.random.default_rng(0)
    (found,) = walls(_wall(rng, 0.6, 0.2), CAMERA)
    assert abs(found.normal[0] + 1.0) < 0.01 and found.offset == pytest.approx(0.2, abs=0.01)
    (other,) = walls(_wall(np.random.default_rng(0), 0.6, 0.2) * (-1, 1, 1), CAMERA * (-1, 1, 1))
    assert abs(other.normal[0] - 1.0) < 0.01, "away from the camera, too"
    assert not walls(_wall(rng, 0.24, 0.25), CAMERA)
    assert not walls(_wall(rng, 0.6, 0.10), CAMERA)


def test_a_row_of_bottles_is_no_wall() -> None:
    rng = np.random.default_rng(0)
    bottles = []
    for y in np.arange(-0.3, 0.31, 0.1):
        angle = rng.uniform(-np.pi / 2, np.pi / 2, 2000)
        bottles.append(
            np.column_stack([0.03 * np.cos(angle), y + 0.03 * np.sin(angle), rng.uniform(0, 0.25, 2000)])
        )
    assert not walls(np.concatenate(bottles), CAMERA)


def test_a_wall_is_an_obstacle_and_nothing_to_grasp() -> None:
    rng = np.random.default_rng(0)
    table = np.column_stack([rng.uniform((-0.18, -0.4), (0.3, 0.4), (60_000, 2)), np.zeros(60_000)])
    block = rng.uniform((0.05, -0.03, 0.0), (0.1, 0.03, 0.08), (3000, 3))
    cloud = np.concatenate([table, block, _wall(rng, 0.7, 0.2)]).astype(np.float32)
    scene = prepare(cloud, CAMERA, rng, PlanRequest())
    assert scene.voxels[:, 0].min() > 0.0, "of what stands there only the block is left"
    assert (np.abs(scene.obstacles[:, 0] + 0.2) < 0.02).sum() > 500
