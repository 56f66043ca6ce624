"""The depth completion: what the network is told, and its weights."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from dgs_description.camera import PinholeCamera
from dgs_description.cell import HOME_ARM
from dgs_description.errors import ErrorCode
from dgs_description.paths import models_dir
from dgs_perception.completion import (
    CLEAR,
    NAME,
    SCALE,
    DepthCompletion,
    completion_net,
    depth_of_plane,
    half_rays,
    network_input,
    table_plane,
)
from dgs_sim_bridge.render.d455 import D455, D455Noise
from dgs_sim_bridge.render.object_model import GLASS, find_catalogue
from dgs_sim_bridge.render.raster import TABLE
from dgs_sim_bridge.render.shot import Shot, take_shot
from dgs_sim_bridge.world.world import World, random_scene
from tests.support.refused import refused
from tests.support.stage import camera_pose, table_stage


def shot(elevation: float, distance: float, noise: D455Noise | None = None) -> Shot:
    pose = camera_pose(elevation, distance)
    return take_shot(table_stage(), D455, pose, noise, np.random.default_rng(0), imagers=1)


@pytest.mark.parametrize("distance", [0.6, 1.1])
@pytest.mark.parametrize("elevation", [0.5, 1.0, 1.5])
def test_the_network_is_told_heights_above_the_table_from_anywhere(elevation: float, distance: float) -> None:
    seen = shot(elevation, distance, D455Noise())
    assert seen.left is not None
    given = network_input(seen.depth, seen.left, D455)
    assert given.features.shape == (4, 240, 424) and given.features.dtype == np.float32
    ids = seen.truth.ids[::2, ::2]
    r, known = given.features[0] / SCALE, given.features[1] > 0
    assert np.abs(np.median(r[known & (ids == TABLE)])) < 0.003
    assert np.median(r[known & (ids >= 0)]) > 0.02


def test_the_plane_is_the_tables_and_always_the_same() -> None:
    seen = shot(1.0, 1.0)
    x, y = half_rays(D455)
    half = seen.truth.depth[::2, ::2]
    plane = table_plane(half, x, y)
    table = seen.truth.ids[::2, ::2] == TABLE
    np.testing.assert_allclose(depth_of_plane(plane, x, y)[table], half[table], atol=2e-3)
    np.testing.assert_array_equal(plane, table_plane(half, x, y))


def test_a_floor_that_shows_more_of_itself_is_not_the_table() -> None:
    x, y = half_rays(D455)
    depth = np.full((len(y), len(x)), 2.0, np.float32)
    depth[60:200, 50:340] = 1.0
    np.testing.assert_allclose(table_plane(depth, x, y), [0, 0, 1], atol=1e-6)
    depth[60:200, 110:340] = 2.0
    np.testing.assert_allclose(table_plane(depth, x, y), [0, 0, 0.5], atol=1e-6)


def test_an_image_without_depth_has_a_plane_at_1_m_and_a_single_row_one_at_its_depth() -> None:
    camera = PinholeCamera.centred(846, 478, 447.0)
    given = network_input(np.zeros((478, 846), np.float32), np.zeros((478, 846), np.uint8), camera)
    np.testing.assert_array_equal(given.plane, [0, 0, 1])
    assert given.features.shape == (4, 238, 422) and np.isfinite(given.features).all()
    row = np.zeros((238, 422), np.float32)
    row[0] = 0.8
    np.testing.assert_allclose(table_plane(row, *half_rays(camera)), [0, 0, 1 / 0.8], rtol=1e-6)


def test_what_the_network_finds_lies_where_it_is_in_an_image_that_cannot_be_halved_twice(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    complete, camera = DepthCompletion(), PinholeCamera.centred(479, 270, 250.0)
    infrared = np.zeros((270, 479), np.uint8)
    infrared[240:, 400:] = 255

    def bright_is_glass(features: torch.Tensor) -> torch.Tensor:
        bright = features[:, 2]
        return torch.stack([40.0 * bright - 20.0, torch.zeros_like(bright), torch.full_like(bright, -9.0)], 1)

    monkeypatch.setattr(complete, "net", bright_is_glass)
    clear = complete(np.ones((270, 479), np.float32), infrared, camera)[1] > CLEAR
    rows, columns = np.nonzero(clear)
    np.testing.assert_allclose([rows.min(), columns.min()], [240, 400], atol=1)
    np.testing.assert_array_equal([rows.max(), columns.max()], [269, 478])


def test_missing_weights_are_refused(tmp_path: Path) -> None:
    with refused(ErrorCode.DEPTH_SOURCE, "dgs train-completion"):
        DepthCompletion(tmp_path / "none.pt")


def test_images_of_another_size_than_the_cameras_are_refused(tmp_path: Path) -> None:
    completion_net().save(tmp_path / "net.pt", {})
    depth, infrared = np.zeros((480, 848), np.float32), np.zeros((480, 640), np.uint8)
    with refused(ErrorCode.DEPTH_FORMAT, "camera's"):
        DepthCompletion(tmp_path / "net.pt")(depth, infrared, D455)


def test_the_shipped_network_finds_glass_and_brings_it_nearer_to_where_it_is() -> None:
    complete, before, after, kept = DepthCompletion(), [], [], []
    for seed in range(4):
        stage, rng = table_stage("glass", "opaque", "glass"), np.random.default_rng(seed)
        seen = take_shot(stage, D455, camera_pose(0.9, 0.95), D455Noise(), rng, imagers=1)
        assert seen.left is not None
        depth, clear = complete(seen.depth, seen.left, D455)
        glass, opaque = np.isin(seen.truth.ids, (0, 2)), seen.truth.ids == 1
        # Without depth counts as far off.
        for errors, image in ((before, seen.depth), (after, depth)):
            errors.append(np.where(image > 0, np.abs(image - seen.truth.depth), 0.2)[glass])
        kept.append((depth == seen.depth)[opaque].mean())
        assert clear[glass].mean() > 3 * clear[~glass].mean()
    assert np.median(np.concatenate(after)) < 0.5 * np.median(np.concatenate(before))
    assert np.mean(kept) > 0.7


def test_in_the_robots_cell_glass_is_found_and_the_robot_stays_as_it_is() -> None:
    complete, found, robot = DepthCompletion(), [], []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        world = World(random_scene(find_catalogue("novel"), 5, seed, 0.4), HOME_ARM + rng.normal(0.0, 0.3, 6))
        snapshot = world.snapshot()
        materials = snapshot.stage.materials
        world.close()
        seen = snapshot.shot(D455Noise(), rng, imagers=1)
        assert seen.left is not None
        depth, clear = complete(seen.depth, seen.left, D455)
        glass = np.array([material == GLASS for material in materials] + [False] * 2)[seen.truth.ids]
        found.append((clear > CLEAR)[glass])
        links = (seen.truth.ids >= 0) & (seen.truth.ids < len(materials) - 5)
        robot.append((depth != seen.depth)[links])
    assert np.concatenate(found).mean() > 0.8
    assert np.concatenate(robot).mean() < 0.01


def test_the_shipped_weights_are_small_and_have_a_card() -> None:
    file = models_dir() / f"{NAME}.pt"
    assert file.stat().st_size < 2e6
    assert "dgs train-completion" in file.with_suffix(".md").read_text()
