from dataclasses import replace

import numpy as np
import pytest

from dgs_description.camera import PinholeCamera
from dgs_sim_bridge.render.d455 import D455, WINDOW, D455Noise, correlated_noise
from tests.support.stage import NO_NOISE
from tests.support.timing import fastest

OFF = replace(NO_NOISE, depth_unit=0)


def flat(z: float) -> np.ndarray:
    return np.full((D455.height, D455.width), z, dtype=np.float32)


def only(**options: float) -> D455Noise:
    return replace(OFF, **options)  # type: ignore[arg-type]


def step_image() -> np.ndarray:
    """A box face at 0.9 m in front of a wall at 1.1 m."""
    depth = flat(1.1)
    depth[150:300, 350:500] = 0.9
    return depth


def test_field_of_view_is_the_data_sheets() -> None:
    horizontal = 2 * np.rad2deg(np.arctan(D455.width / 2 / D455.fx))
    vertical = 2 * np.rad2deg(np.arctan(D455.height / 2 / D455.fy))
    assert horizontal == pytest.approx(87, abs=3)
    assert vertical == pytest.approx(58, abs=3)


def test_everything_off_changes_nothing() -> None:
    depth = step_image()
    np.testing.assert_allclose(OFF.apply(depth, D455, np.random.default_rng(0)), depth, atol=1e-6)


@pytest.mark.parametrize("z", [0.5, 1.0, 1.5])
def test_depth_error_grows_with_the_square_of_the_distance(z: float) -> None:
    noisy = only(subpixel_rms=0.1).apply(flat(z), D455, np.random.default_rng(0))
    expected = z**2 * 0.1 / (D455.fx * OFF.baseline)
    assert noisy.std() == pytest.approx(expected, rel=0.1)


def test_matching_error_is_correlated_over_the_patch_and_not_beyond() -> None:
    noise = correlated_noise((480, 848), np.random.default_rng(1))
    assert noise.std() == pytest.approx(1.0, rel=0.03)
    assert np.corrcoef(noise[:, :-3].ravel(), noise[:, 3:].ravel())[0, 1] > 0.4
    assert abs(np.corrcoef(noise[:, :-12].ravel(), noise[:, 12:].ravel())[0, 1]) < 0.05


def test_disparity_comes_in_steps() -> None:
    ramp = np.tile(np.linspace(0.8, 1.2, D455.width, dtype=np.float32), (D455.height, 1))
    out = only(quantisation=1 / 32).apply(ramp, D455, np.random.default_rng(0))
    steps = D455.fx * OFF.baseline / out.astype(np.float64) * 32
    np.testing.assert_allclose(steps, np.rint(steps), atol=1e-2)
    assert len(np.unique(out)) < 600


def test_depth_comes_in_millimetres() -> None:
    out = D455Noise().apply(step_image(), D455, np.random.default_rng(0)) * 1000
    np.testing.assert_allclose(out, np.rint(out), atol=1e-3)


def test_left_band_has_no_depth() -> None:
    out = only(shadows=True).apply(flat(1.0), D455, np.random.default_rng(0))
    band = D455.fx * OFF.baseline / 1.0  # disparity at 1 m: 5 % of the width
    empty = np.flatnonzero((out == 0).all(axis=0))
    assert len(empty) == pytest.approx(band, abs=1)
    assert empty.max() == len(empty) - 1


def test_shadow_lies_left_of_the_foreground() -> None:
    out = only(shadows=True).apply(step_image(), D455, np.random.default_rng(0))
    expected = D455.fx * OFF.baseline * (1 / 0.9 - 1 / 1.1)
    row = out[220]
    assert (row[350 - int(expected) + 1 : 350] == 0).all()
    assert (row[350:840] > 0).all()


def _from_edge(where: np.ndarray) -> np.ndarray:
    v, u = np.nonzero(where)
    return np.minimum.reduce([abs(v - 150), abs(v - 300), abs(u - 350), abs(u - 500)])


def test_a_smeared_edge_is_a_curtain_as_wide_as_the_window() -> None:
    out = only(smeared=1.0).apply(step_image(), D455, np.random.default_rng(0))
    assert (np.diff(out[220, 490:510]) >= 0).all()
    curtain = (out > 0.91) & (out < 1.09)
    assert 5 <= curtain[220, 480:520].sum() <= WINDOW
    assert _from_edge(curtain).max() <= WINDOW // 2 + 1


def test_curtains_and_gaps_take_their_share_of_the_edges() -> None:
    shots = [
        only(smeared=0.3, dropped=0.2).apply(step_image(), D455, np.random.default_rng(k)) for k in range(8)
    ]
    side = np.concatenate([shot[155:295, 490:510] for shot in shots])
    gap, curtain = (side == 0).any(1), ((side > 0.91) & (side < 1.09)).sum(1) > 2
    assert 0.1 < gap.mean() < 0.3 and 0.2 < curtain.mean() < 0.4
    assert not (gap & curtain).any()
    assert max(_from_edge(shot == 0).max() for shot in shots) <= 2


def test_edges_wander_but_surfaces_stay() -> None:
    depth = step_image()
    out = only(edge_jitter=1.0).apply(depth, D455, np.random.default_rng(0))
    away = _from_edge(out != depth)
    assert len(away) > 50 and away.max() <= 4


def test_grazing_surfaces_drop_out_and_others_do_not() -> None:
    # z grows by the factor exp(0.02) per pixel: tan of the incidence = f * dz / z = 9, 84 degrees.
    steep = np.tile(0.5 * np.exp(0.004 * np.arange(D455.width)), (D455.height, 1)).astype(np.float32)
    noise = only(grazing_angle=float(np.deg2rad(50)))
    out, facing = (noise.apply(depth, D455, np.random.default_rng(0)) for depth in (steep, flat(1)))
    assert 0.1 < (out == 0).mean() < 0.9 and (facing > 0).all()


def test_too_near_and_too_far_have_no_depth() -> None:
    for z in (0.30, 7.0):
        assert (OFF.apply(flat(z), D455, np.random.default_rng(0)) == 0).all()
    assert (OFF.apply(flat(0.36), D455, np.random.default_rng(0)) > 0).all()


def test_holes_stay_holes() -> None:
    depth = step_image()
    depth[400:450, 600:700] = 0
    assert (D455Noise().apply(depth, D455, np.random.default_rng(0))[410:440, 610:690] == 0).all()


def test_same_seed_same_image_other_seed_another() -> None:
    a, b, c = (D455Noise().apply(step_image(), D455, np.random.default_rng(s)) for s in (3, 3, 4))
    np.testing.assert_array_equal(a, b)
    assert (a != c).any()


def test_noise_is_fast() -> None:
    depth, rng = step_image(), np.random.default_rng(0)
    # 25 ms on an idle core, 110 ms where memory is slow to come
    assert fastest(lambda: D455Noise().apply(depth, D455, rng)) < 0.4


def test_any_camera_size_works() -> None:
    small = PinholeCamera(width=101, height=57, fx=50, fy=50, cx=50, cy=28)
    out = D455Noise().apply(np.full((57, 101), 1.0, np.float32), small, np.random.default_rng(0))
    assert out.shape == (57, 101)
    assert (out > 0).mean() > 0.9
