from functools import partial

import numpy as np
import pybullet
import pytest
from scipy.spatial.transform import Rotation

from dgs_description.camera import PinholeCamera
from dgs_description.cell import CELL
from dgs_description.frames import look_at, transform
from dgs_sim_bridge.render.d455 import D455
from dgs_sim_bridge.render.object_model import ObjectModel, find_catalogue
from dgs_sim_bridge.render.raster import NOTHING, TABLE, box_mesh, render
from dgs_sim_bridge.world.physics import new_world
from tests.support.timing import fastest

SMALL = PinholeCamera(width=160, height=120, fx=120, fy=120, cx=79.5, cy=59.5)
AHEAD = np.eye(4)
"""Camera in the world's origin that looks along z."""


@pytest.fixture(scope="module")
def clutter() -> list[tuple[ObjectModel, np.ndarray]]:
    rng = np.random.default_rng(4)
    catalogue = find_catalogue("novel")
    chosen = [catalogue[k] for k in rng.choice(len(catalogue), 10, replace=False)]
    centre = CELL.T_base_table[:3, 3] + (0, 0, 0.06)
    return [
        (
            model,
            transform(Rotation.random(rng=rng).as_matrix(), centre + rng.uniform(-0.2, 0.2, 3) * (1, 2, 0.2)),
        )
        for model in chosen
    ]


def table() -> tuple[np.ndarray, np.ndarray]:
    return box_mesh((-0.1, -0.6, CELL.table_height - 0.04), (0.8, 0.6, CELL.table_height))


def pybullet_depth(clutter: list, camera: PinholeCamera, T_world_camera: np.ndarray) -> np.ndarray:
    """Depth of PyBullet's own software renderer for the same scene."""
    bullet = new_world()
    vertices, faces = table()
    items = [(vertices, faces, np.eye(4))] + [(m.vertices, m.faces, pose) for m, pose in clutter]
    for points, triangles, pose in items:
        world = points @ pose[:3, :3].T + pose[:3, 3]
        shape = bullet.createVisualShape(
            pybullet.GEOM_MESH, vertices=world.tolist(), indices=triangles.ravel().tolist()
        )
        bullet.createMultiBody(0, baseVisualShapeIndex=shape)
    near, far = 0.1, 3.0
    w, h = camera.width, camera.height
    # PyBullet's renderer samples a pixel at its left lower corner: column u at x = 2 u / w - 1, row v at
    # y = 1 - 2 (v + 1) / h of its clip space.
    projection = np.array(
        [
            [2 * camera.fx / w, 0, 1 - 2 * camera.cx / w, 0],
            [0, 2 * camera.fy / h, 2 * (camera.cy + 1) / h - 1, 0],
            [0, 0, -(far + near) / (far - near), -2 * far * near / (far - near)],
            [0, 0, -1, 0],
        ]
    )
    view = np.linalg.inv(T_world_camera @ np.diag([1.0, -1.0, -1.0, 1.0]))
    image = bullet.getCameraImage(
        w,
        h,
        viewMatrix=view.T.ravel().tolist(),
        projectionMatrix=projection.T.ravel().tolist(),
        renderer=pybullet.ER_TINY_RENDERER,
        flags=pybullet.ER_NO_SEGMENTATION_MASK,
    )
    buffer = np.asarray(image[3], dtype=np.float64).reshape(h, w)
    depth = far * near / (far - (far - near) * buffer)
    return np.where(depth < 0.999 * far, depth, 0.0)


def test_agrees_with_pybullets_renderer(clutter: list) -> None:
    T_world_camera = CELL.T_base_camera_optical
    meshes, poses = zip(*((m.mesh, pose) for m, pose in clutter), strict=True)
    ours = render(meshes, poses, D455, T_world_camera, table=table())
    theirs = pybullet_depth(clutter, D455, T_world_camera)
    seen = (ours.depth > 0) | (theirs > 0)
    assert seen.sum() > 100_000
    assert (np.abs(ours.depth - theirs)[seen] < 0.001).mean() > 0.99
    on_objects = ours.ids >= 0
    assert on_objects.sum() > 5000
    assert (np.abs(ours.depth - theirs)[on_objects] < 0.001).mean() > 0.99


def test_facing_square_has_exact_depth_size_and_normal() -> None:
    box = box_mesh((-0.1, -0.05, 1.0), (0.1, 0.05, 1.2))
    view = render([box], [np.eye(4)], SMALL, AHEAD, normals=True)
    hit = view.depth > 0
    np.testing.assert_allclose(view.depth[hit], 1.0, atol=1e-6)
    v, u = np.nonzero(hit)
    assert u.max() - u.min() + 1 == pytest.approx(0.2 * SMALL.fx, abs=1)
    assert v.max() - v.min() + 1 == pytest.approx(0.1 * SMALL.fy, abs=1)
    assert hit.sum() == (u.max() - u.min() + 1) * (v.max() - v.min() + 1)  # no holes along the diagonal
    assert view.normals is not None
    np.testing.assert_allclose(view.normals[hit], np.tile([0, 0, -1.0], (hit.sum(), 1)), atol=1e-6)
    assert (view.ids[hit] == 0).all() and (view.ids[~hit] == NOTHING).all()
    assert (view.normals[~hit] == 0).all()


def test_inverse_depth_is_perspective_correct_on_a_tilted_plane() -> None:
    T_world_camera = look_at((0, 0, 1.0), (0.8, 0.1, 0))
    view = render([], [], SMALL, T_world_camera, table=box_mesh((-5, -5, -1), (5, 5, 0)))
    points = SMALL.deproject(view.depth) @ T_world_camera[:3, :3].T + T_world_camera[:3, 3]
    assert (view.ids[view.depth > 0] == TABLE).all()
    on_top = (np.abs(points[:, :2]) < 4.9).all(1)
    assert on_top.sum() > 10_000
    np.testing.assert_allclose(points[on_top, 2], 0, atol=2e-5)


def test_nearer_mesh_wins_whatever_the_order() -> None:
    near, far = box_mesh((-0.1, -0.1, 0.8), (0.1, 0.1, 0.9)), box_mesh((-0.3, -0.3, 1.0), (0.3, 0.3, 1.1))
    one = render([near, far], [np.eye(4)] * 2, SMALL, AHEAD)
    two = render([far, near], [np.eye(4)] * 2, SMALL, AHEAD)
    np.testing.assert_array_equal(one.depth, two.depth)
    assert one.ids[60, 80] == 0 and two.ids[60, 80] == 1
    assert one.depth[60, 80] == pytest.approx(0.8)


def test_poses_move_meshes() -> None:
    box = box_mesh((-0.05,) * 3, (0.05,) * 3)
    moved = render([box], [transform(position=(0.1, 0.2, 1.0))], SMALL, AHEAD)
    v, u = np.nonzero(moved.depth)
    np.testing.assert_allclose([u.mean(), v.mean()], SMALL.project(np.array([[0.1, 0.2, 0.95]]))[0], atol=2)
    seen_from_there = render([box], [np.eye(4)], SMALL, transform(position=(-0.1, -0.2, -1.0)))
    np.testing.assert_allclose(moved.depth, seen_from_there.depth, atol=1e-6)


@pytest.mark.parametrize("start", [-1.0, -0.2, 0.01])
def test_what_reaches_behind_the_camera_is_cut(start: float) -> None:
    """A floor that runs from behind the camera to 3 m ahead covers the lower half of the picture completely."""
    floor = box_mesh((-9, 0.1, start), (9, 0.2, 3.0))
    view = render([floor], [np.eye(4)], SMALL, AHEAD)
    v, u = np.nonzero(view.depth)
    assert (view.depth[100:, :] > 0).all()
    points = SMALL.deproject(view.depth)
    np.testing.assert_allclose(points[:, 1], 0.1, atol=1e-5)
    assert view.depth[view.depth > 0].min() >= 0.05


def test_mesh_behind_the_camera_or_out_of_view_is_not_there() -> None:
    behind, aside = box_mesh((-1, -1, -2), (1, 1, -1)), box_mesh((5, 0, 1), (6, 1, 2))
    for meshes in ([], [behind, aside]):
        view = render(meshes, [np.eye(4)] * len(meshes), SMALL, AHEAD)
        assert view.depth.shape == (120, 160) and not view.depth.any() and (view.ids == NOTHING).all()


def test_neighbouring_triangles_leave_no_gap() -> None:
    rng = np.random.default_rng(0)
    n = 12
    x, y = np.meshgrid(np.linspace(-2, 2, n), np.linspace(-2, 2, n))
    x[1:-1, 1:-1] += rng.uniform(-0.1, 0.1, (n - 2, n - 2))
    y[1:-1, 1:-1] += rng.uniform(-0.1, 0.1, (n - 2, n - 2))
    vertices = np.column_stack([x.ravel(), y.ravel(), rng.uniform(1.0, 1.2, n * n)])
    k = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    faces = np.concatenate([np.column_stack([k, k + n, k + 1]), np.column_stack([k + 1, k + n, k + n + 1])])
    assert (render([(vertices, faces)], [np.eye(4)], SMALL, AHEAD).depth > 0).all()


def test_rendering_is_fast(clutter: list) -> None:
    meshes, poses = zip(*((m.mesh, pose) for m, pose in clutter), strict=True)
    seen = partial(render, meshes, poses, D455, CELL.T_base_camera_optical, table=table())
    assert fastest(seen) < 0.3
