from contextlib import closing

import numpy as np
import pytest

from dgs_description.cell import CELL
from dgs_description.frames import apply, inverse
from dgs_description.hand import HAND
from dgs_sim_bridge.render.d455 import D455, D455Noise
from dgs_sim_bridge.render.meshes import link_meshes
from dgs_sim_bridge.render.object_model import find_catalogue
from dgs_sim_bridge.render.shot import Shot
from dgs_sim_bridge.world.camera import Snapshot
from dgs_sim_bridge.world.world import World, random_scene

LINKS = [mesh.link for mesh in link_meshes()]
FIRST_OBJECT = len(LINKS)
"""Index of the first object in a snapshot: the cell's links come before."""
CATALOGUE = find_catalogue("novel")


@pytest.fixture(scope="module")
def snapshot() -> Snapshot:
    with closing(World(random_scene(CATALOGUE, 5, seed=1))) as world:
        return world.snapshot()


@pytest.fixture(scope="module")
def shot(snapshot: Snapshot) -> Shot:
    return snapshot.shot()


def in_base(shot: Shot) -> np.ndarray:
    return apply(CELL.T_base_camera_optical, D455.deproject(shot.depth).astype(float))


def test_points_of_objects_lie_on_the_objects(snapshot: Snapshot, shot: Shot) -> None:
    points, ids = in_base(shot), shot.truth.ids[shot.depth > 0]
    for k in range(FIRST_OBJECT, len(snapshot.stage.meshes)):
        mine = points[ids == k]
        assert len(mine) > 50
        local = apply(inverse(snapshot.stage.poses[k]), mine)
        vertices = snapshot.stage.meshes[k][0]
        assert (local > vertices.min(0) - 1e-3).all() and (local < vertices.max(0) + 1e-3).all()


def test_table_is_seen_at_its_height(shot: Shot) -> None:
    points = in_base(shot)[shot.truth.ids[shot.depth > 0] == LINKS.index("table")]
    low, high = CELL.workspace_bounds
    inside = ((points[:, :2] > low[:2]) & (points[:, :2] < high[:2])).all(1)
    assert inside.sum() > 30_000
    np.testing.assert_allclose(points[inside, 2], CELL.table_height, atol=1e-4)


def test_robot_at_home_does_not_hide_the_workspace(snapshot: Snapshot, shot: Shot) -> None:
    points = in_base(shot)
    low, high = CELL.workspace_bounds
    robot = np.isin(shot.truth.ids[shot.depth > 0], range(FIRST_OBJECT))
    table = LINKS.index("table")
    robot &= shot.truth.ids[shot.depth > 0] != table
    inside = ((points > low) & (points < high)).all(1)
    assert not (robot & inside).any()
    grid = np.stack(
        np.meshgrid(np.linspace(low[0], high[0], 9), np.linspace(low[1], high[1], 17)), -1
    ).reshape(-1, 2)
    grid = np.column_stack([grid, np.full(len(grid), CELL.table_height)])
    seen = apply(inverse(CELL.T_base_camera_optical), grid)
    u, v = D455.project(seen).round().astype(int).T
    assert (shot.truth.ids[v, u] >= 0).all()
    assert set(np.unique(shot.truth.ids[v, u])) <= {table, *range(FIRST_OBJECT, len(snapshot.stage.meshes))}


def test_arm_appears_in_the_picture_where_it_moves(snapshot: Snapshot, shot: Shot) -> None:
    # The hand is 0.25 m above the workspace.
    with closing(World(arm_joints=(-0.39, -1.66, 2.1, -2.01, -1.57, -1.97))) as world:
        moved = world.snapshot().shot()
    hand = [k for k, name in enumerate(LINKS) if name.split("_")[0] in HAND.fingers]
    finger = np.isin(moved.truth.ids, hand)
    assert finger.sum() > 500
    points = apply(CELL.T_base_camera_optical, D455.deproject(np.where(finger, moved.depth, 0)).astype(float))
    np.testing.assert_allclose(points.mean(0), (0.33, 0.0, CELL.table_height + 0.25), atol=0.08)
    assert np.argwhere(finger).mean(0)[0] > np.argwhere(np.isin(shot.truth.ids, hand)).mean(0)[0] + 30


def test_colour_matches_the_depth_image(shot: Shot, snapshot: Snapshot) -> None:
    colour = snapshot.colour(shot.truth)
    assert colour.shape == (D455.height, D455.width, 3) and colour.dtype == np.uint8
    first = colour[shot.truth.ids == FIRST_OBJECT].astype(float).mean(0)
    second = colour[shot.truth.ids == FIRST_OBJECT + 1].astype(float).mean(0)
    assert first[0] > first[2] and second[2] > second[0]  # red object, blue object


def test_noise_is_repeatable_and_leaves_most_depth(snapshot: Snapshot, shot: Shot) -> None:
    one, two = (snapshot.shot(D455Noise(), np.random.default_rng(5)) for _ in range(2))
    np.testing.assert_array_equal(one.depth, two.depth)
    both = (one.depth > 0) & (shot.depth > 0)
    assert both.mean() > 0.85
    assert 0.0005 < np.median(np.abs(one.depth - shot.depth)[both]) < 0.004


def test_half_of_a_scene_is_glass_lies_as_it_would_and_is_hardly_seen() -> None:
    scenes = {share: random_scene(CATALOGUE, 4, seed=1, transparent=share) for share in (0.0, 0.5)}
    for plain, clear in zip(*scenes.values(), strict=True):
        np.testing.assert_array_equal(plain.pose, clear.pose)
    glass = [item.model.material == "glass" for item in scenes[0.5]]
    assert sum(glass) == 2
    with closing(World(scenes[0.5])) as world:
        shot = world.snapshot().shot()
    points, ids = in_base(shot), shot.truth.ids[shot.depth > 0]
    above = [
        (points[ids == FIRST_OBJECT + k][:, 2] > CELL.table_height + 0.008).sum()
        / (shot.truth.ids == FIRST_OBJECT + k).sum()
        for k in range(4)
    ]
    assert all((share < 0.4) == clear for share, clear in zip(above, glass, strict=True)), above
