"""Flying pixels go or become rims, surfaces stay: in rendered views whose true depth is known, and at single shapes."""

from __future__ import annotations

import time

import numpy as np
import pytest

from dgs_description.camera import PinholeCamera
from dgs_description.frames import look_at, transform
from dgs_perception.edges import clean_points, cleaned
from dgs_sim_bridge.render.d455 import D455, D455Noise
from dgs_sim_bridge.render.object_model import find_catalogue
from dgs_sim_bridge.render.raster import box_mesh, render

CAMERA = PinholeCamera.centred(20, 20, 447.0)
TABLE = box_mesh((-0.6, -0.6, -0.02), (0.6, 0.6, 0.0))


def _flying(ideal: np.ndarray, noisy: np.ndarray) -> np.ndarray:
    """(H, W) pixels whose depth is that of no surface within three pixels."""
    limit = 0.002 + 0.4 * noisy**2 / (D455.fx * D455Noise().baseline)
    real = np.zeros(noisy.shape, bool)
    for down, right in np.ndindex(7, 7):
        near = np.roll(ideal, (down - 3, right - 3), (0, 1))
        real |= (np.abs(near - noisy) < limit) & (near > 0)
    return (noisy > 0) & ~real


@pytest.mark.parametrize(("distance", "elevation_deg"), [(1.0, 50.0), (0.45, 80.0), (1.0, 15.0)])
def test_flying_pixels_become_rims_or_go_and_nearly_all_others_stay(
    distance: float, elevation_deg: float
) -> None:
    rng, elevation = np.random.default_rng(1), np.deg2rad(elevation_deg)
    eye = distance * np.array([np.cos(elevation), 0.1, np.sin(elevation)])
    models = [find_catalogue("novel")[k] for k in (3, 20, 40, 60)]
    poses = [
        transform(position=(x, y, -model.vertices[:, 2].min()))
        for model, x, y in zip(models, (-0.1, 0.1, -0.1, 0.1), (-0.1, -0.1, 0.1, 0.1), strict=True)
    ]
    meshes = [model.mesh for model in models]
    view = render(meshes, poses, D455, look_at(eye, (0, 0, 0)), table=TABLE)
    noisy = D455Noise(smeared=0.6).apply(view.depth, D455, rng)
    clean = cleaned(noisy, D455)
    flying = _flying(view.depth, noisy)
    assert flying.sum() > 100
    assert (clean != noisy)[flying].mean() > 0.75
    assert _flying(view.depth, clean).sum() < 0.3 * flying.sum()
    measured = noisy > 0
    table = measured & ~flying & (view.ids < 0)
    assert (clean[table] == 0).mean() < 0.03
    thing = measured & (view.ids >= 0)
    rim = thing & flying
    assert (clean[thing] == 0).mean() < 0.05
    right = np.abs(clean - view.depth) < 0.002 + 0.4 * view.depth**2 / (D455.fx * D455Noise().baseline)
    assert right[rim].mean() > 0.2


def _image(thing: tuple[slice, slice], depth: float = 0.9) -> np.ndarray:
    z = np.full((20, 20), 1.0, np.float32)
    z[thing] = depth
    return z


def test_a_single_pixel_between_goes_and_a_rod_of_two_pixels_stays() -> None:
    clean = cleaned(_image((slice(10, 11), slice(10, 11))), CAMERA)
    assert clean[10, 10] == 0 and clean[10, 8] == 1.0 and clean[5, 5] == 1.0
    rod = _image((slice(2, 18), slice(10, 12)))
    np.testing.assert_array_equal(cleaned(rod, CAMERA)[3:17, 10:12], rod[3:17, 10:12])
    alone = np.zeros((20, 20), np.float32)
    alone[1:4, 1:4] = 1.0
    np.testing.assert_array_equal(cleaned(alone, CAMERA), alone)


@pytest.mark.parametrize("incidence", [70.0, 78.0])
def test_a_steep_surface_stays(incidence: float) -> None:
    """Its disparity is that of a plane, so that the angle does not matter where nothing else is in view."""
    slope = np.tan(np.deg2rad(incidence)) / CAMERA.fx
    steep = np.tile((1.0 / (1.0 - slope * np.arange(20))).astype(np.float32), (20, 1))
    np.testing.assert_array_equal(cleaned(steep, CAMERA)[1:-1, 1:-1], steep[1:-1, 1:-1])


def test_the_top_of_a_box_stays_where_the_table_is_as_steep() -> None:
    """A camera 16 degrees above the table, 0.28 m above it and 0.2 m above the box."""
    camera, rows = PinholeCamera.centred(100, 100, 447.0), np.arange(100.0)
    below = np.deg2rad(16.0) + np.arctan((rows - camera.cy) / camera.fy)
    depth = np.cos(below - np.deg2rad(16.0)) / np.sin(below)
    table, top, front = 0.28 * depth, 0.20 * depth, 0.28 * depth[60]
    on_top = (top > front) & (top < front + 0.08)
    assert on_top.sum() >= 5
    column = np.where(on_top, top, np.where((rows > 60) | (top > front), table, front))
    z = np.tile(table[:, None], (1, 100)).astype(np.float32)
    z[:, 30:70] = column.astype(np.float32)[:, None]
    clean = cleaned(z, camera)
    np.testing.assert_array_equal(clean[on_top, 31:69], z[on_top, 31:69])


def test_half_of_a_curtain_is_the_thing_s_rim_and_half_goes() -> None:
    curtain = np.hstack([_image((slice(0, 20), slice(0, 8)), 0.8), np.ones((20, 40), np.float32)])
    curtain[:, 8:12] = (0.83, 0.86, 0.93, 0.96)
    clean = cleaned(curtain, PinholeCamera.centred(60, 20, 447.0))
    np.testing.assert_allclose(clean[:, :10], 0.8, atol=1e-6)
    assert not clean[:, 10:12].any() and (clean[1:-1, 12:-1] == 1.0).all()


def test_where_no_background_is_seen_the_whole_curtain_is_rim() -> None:
    """Behind the edge that turns away from the right imager there is no depth."""
    curtain = _image((slice(0, 20), slice(0, 8)), 0.8)
    curtain[:, 8:] = 0.0
    curtain[:, 8:10] = (0.84, 0.90)
    np.testing.assert_allclose(cleaned(curtain, CAMERA)[:, :10], 0.8, atol=1e-6)


def test_what_lies_in_a_hole_behind_a_thing_is_not_its_rim() -> None:
    hole = _image((slice(0, 20), slice(0, 8)), 0.8)
    hole[:, 8:] = 0.0
    hole[10, 13], hole[4, 14] = 3.0, 1.0
    clean = cleaned(hole, CAMERA)
    assert not clean[:, 8:].any()


def test_speckle_is_no_surface() -> None:
    """Any three pixels lie on a plane."""
    rng = np.random.default_rng(0)
    speckle = np.where(rng.random((480, 848)) < 0.01, rng.uniform(0.4, 2.0, (480, 848)), 0).astype(np.float32)
    assert (cleaned(speckle, D455) > 0).sum() < 0.02 * (speckle > 0).sum()


def test_an_image_of_flying_pixels_alone_is_refused_quickly() -> None:
    fog = np.random.default_rng(0).uniform(0.3, 2.0, (480, 848)).astype(np.float32)
    start = time.process_time()
    assert (cleaned(fog, D455) > 0).mean() < 0.05
    assert time.process_time() - start < 1.0


@pytest.mark.parametrize("nothing", [0.0, np.nan, np.inf])
def test_points_that_are_no_measurement_stay(nothing: float) -> None:
    depth = _image((slice(10, 11), slice(10, 11)))
    depth[:5] = nothing
    points = CAMERA.all_points(depth)
    before = points.copy()
    clean_points(points, CAMERA)
    assert not points[10 * 20 + 10].any()
    np.testing.assert_array_equal(np.delete(points, 10 * 20 + 10, 0), np.delete(before, 10 * 20 + 10, 0))


def test_points_move_along_their_rays() -> None:
    curtain = _image((slice(0, 20), slice(0, 8)), 0.8)
    curtain[:, 8:10] = (0.83, 0.86)
    points = CAMERA.all_points(curtain)
    clean_points(points, CAMERA)
    expected = CAMERA.all_points(cleaned(curtain, CAMERA))
    np.testing.assert_allclose(points, expected, atol=1e-6)
