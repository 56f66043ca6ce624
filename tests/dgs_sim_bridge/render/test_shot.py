"""What the D455 delivers of opaque things, of glass and of mirrors."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import binary_erosion

from dgs_sim_bridge.render.d455 import D455, D455Noise
from dgs_sim_bridge.render.glass import GLASS_ERRORS
from dgs_sim_bridge.render.raster import TABLE, render
from dgs_sim_bridge.render.shot import Shot, take_shot
from tests.support.stage import camera_pose, table_stage

POSE = camera_pose()


def shot(*materials: str, seed: int = 0, imagers: int = 0, noise: D455Noise | None = None) -> Shot:
    return take_shot(
        table_stage(*materials), D455, POSE, noise, np.random.default_rng(seed), imagers=imagers, normals=True
    )


def test_opaque_scenes_are_seen_as_ever_with_and_without_infrared() -> None:
    stage = table_stage()
    ideal = render(stage.meshes, stage.poses, D455, POSE, table=stage.table).depth
    expected = D455Noise().apply(ideal, D455, np.random.default_rng(0))
    np.testing.assert_array_equal(shot(noise=D455Noise()).depth, expected)
    np.testing.assert_array_equal(shot(noise=D455Noise(), imagers=2).depth, expected)


def test_glass_has_holes_and_background_and_hardly_its_own_depth() -> None:
    shares = []
    for seed in range(12):
        seen = shot("glass", "glass", "glass", seed=seed)
        inside = binary_erosion(seen.truth.ids >= 0, iterations=5)
        depth, true = seen.depth[inside], seen.truth.depth[inside]
        behind = render([], [], D455, POSE, table=table_stage().table).depth[inside]
        shares.append([(depth == 0).mean(), np.isclose(depth, behind).mean(), (depth == true).mean()])
    missing, far, right = np.mean(shares, axis=0)
    assert (missing, far) == pytest.approx(GLASS_ERRORS[:2], abs=0.1)
    assert 0.002 < right < 0.1


def test_rims_are_partly_kept() -> None:
    seen = shot("glass", "glass", "glass")
    objects = seen.truth.ids >= 0
    rim = objects & ~binary_erosion(objects)
    assert 0.15 < (seen.depth == seen.truth.depth)[rim].mean() < 0.5


def test_mirrors_are_seen_behind_their_surface_or_not_at_all() -> None:
    seen = shot("mirror", "opaque", "opaque")
    inside = binary_erosion(seen.truth.ids == 0, iterations=5)
    depth, true = seen.depth[inside], seen.truth.depth[inside]
    assert (depth == 0).mean() > 0.3
    assert (depth[depth > 0] >= true[depth > 0]).mean() > 0.8


def test_what_is_opaque_is_not_touched_by_glass_beside_it() -> None:
    seen, plain = shot("glass"), shot()
    opaque = (plain.truth.ids == TABLE) | (plain.truth.ids == 1)
    np.testing.assert_array_equal(seen.depth[opaque], plain.depth[opaque])


def test_an_infrared_pair_shows_the_same_surface_shifted_by_its_disparity() -> None:
    pair = shot(imagers=2)
    assert pair.left is not None and pair.right is not None
    v, u = np.nonzero(binary_erosion(pair.truth.ids == TABLE, iterations=9))
    v, u = v[::7], u[::7]
    disparity = D455.fx * 0.095 / pair.truth.depth[v, u]
    there = np.rint(u - disparity).astype(int)
    ok = there > 0
    left, right = pair.left[v[ok], u[ok]].astype(float), pair.right[v[ok], there[ok]].astype(float)
    elsewhere = pair.right[v[ok], np.maximum(there[ok] - 15, 0)].astype(float)
    assert np.corrcoef(left, right)[0, 1] > 0.6 > 0.35 > np.corrcoef(left, elsewhere)[0, 1]


def test_infrared_images_depend_on_the_seed_alone() -> None:
    one, two, other = (shot("glass", seed=seed, imagers=2) for seed in (3, 3, 4))
    np.testing.assert_array_equal(one.left, two.left)
    np.testing.assert_array_equal(one.right, two.right)
    assert (one.left != other.left).any()


def test_glass_can_be_seen_in_infrared_most_of_all_where_it_is_looked_at_flatly() -> None:
    clear, gone = shot("opaque", "glass", imagers=1), table_stage()
    without = take_shot(
        type(gone)([gone.meshes[0], gone.meshes[2]], gone.poses[[0, 2]], (), gone.table),
        D455, POSE, None, np.random.default_rng(0), imagers=1,
    )  # fmt: skip
    assert clear.left is not None and without.left is not None and clear.truth.normals is not None
    glass = clear.truth.ids == 1
    difference = np.abs(clear.left.astype(float) - without.left)
    v, u = np.nonzero(glass)
    ray = np.column_stack([(u - D455.cx) / D455.fx, (v - D455.cy) / D455.fy, np.ones(len(u))])
    cosine = -(clear.truth.normals[v, u] * ray).sum(1) / np.linalg.norm(ray, axis=1)
    flat, facing = difference[v, u][cosine < 0.25], difference[v, u][cosine > 0.8]
    assert flat.mean() > 1.2 * facing.mean() > 0
    assert flat.mean() > 10
