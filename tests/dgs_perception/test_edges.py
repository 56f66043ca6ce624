"""Flying pixels go, surfaces stay: in rendered views whose true depth is known, and at single shapes."""

from __future__ import annotations

import numpy as np
import pytest

from dgs_description.camera import PinholeCamera
from dgs_description.frames import look_at, transform
from dgs_perception.edges import EdgeFilter
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
def test_nearly_all_flying_pixels_go_and_nearly_all_others_stay(
    distance: float, elevation_deg: float
) -> None:
    rng, elevation = np.random.default_rng(1), np.deg2rad(elevation_deg)
    eye = distance * np.array([np.cos(elevation), 0.1, np.sin(elevation)])
    models = [find_catalogue("novel")[k] for k in (3, 20, 40, 60)]
    poses = [
        transform(position=(x, y, -model.vertices[:, 2].min()))
        for model, x, y in zip(models, (-0.1, 0.1, -0.1, 0.1), (-0.1, -0.1, 0.1, 0.1), strict=True)
    ]
    meshes = [(model.vertices, model.faces) for model in models]
    view = render(meshes, poses, D455, look_at(eye, (0, 0, 0)), table=TABLE)
    noisy = D455Noise(smeared=0.6).apply(view.depth, D455, rng)
    gone = (noisy > 0) & ~EdgeFilter().kept(noisy, D455)
    flying = _flying(view.depth, noisy)
    assert flying.sum() > 100
    assert gone[flying].mean() > 0.8
    surface = (noisy > 0) & ~flying
    assert gone[surface].mean() < 0.05
    assert gone[surface & (view.ids >= 0)].mean() < 0.10


def _image(thing: tuple[slice, slice], depth: float = 0.9) -> np.ndarray:
    z = np.full((20, 20), 1.0, np.float32)
    z[thing] = depth
    return z


def test_a_single_pixel_between_goes_and_a_rod_of_two_pixels_stays() -> None:
    kept = EdgeFilter().kept(_image((slice(10, 11), slice(10, 11))), CAMERA)
    assert not kept[10, 10] and kept[10, 8] and kept[5, 5]
    assert EdgeFilter().kept(_image((slice(2, 18), slice(10, 12))), CAMERA)[3:17, 10:12].all()


def test_a_steep_surface_stays_and_a_curtain_goes() -> None:
    slope = np.tan(np.deg2rad(70.0)) / CAMERA.fx
    steep = np.tile((1.0 + slope * np.arange(20)).astype(np.float32), (20, 1))
    assert EdgeFilter().kept(steep, CAMERA)[1:-1, 1:-1].all()
    curtain = _image((slice(0, 20), slice(0, 8)), 0.8)
    curtain[:, 8:12] = (0.84, 0.88, 0.92, 0.96)
    kept = EdgeFilter().kept(curtain, CAMERA)
    assert not kept[:, 8:12].any() and kept[1:-1, :8].all() and kept[1:-1, 12:].all()


@pytest.mark.parametrize("nothing", [0.0, np.nan])
def test_points_that_are_no_measurement_are_not_counted(nothing: float) -> None:
    depth = _image((slice(10, 11), slice(10, 11)))
    depth[:5] = nothing
    points = CAMERA.all_points(depth)
    assert EdgeFilter().apply(points, CAMERA) == 1
    assert not points[10 * 20 + 10].any()
