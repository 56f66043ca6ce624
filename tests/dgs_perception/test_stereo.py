"""Stereo on rendered infrared pairs with known depth, with OpenCV's matcher and with an ONNX network."""

from __future__ import annotations

import builtins
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from dgs_description.camera import PinholeCamera
from dgs_description.errors import ErrorCode
from dgs_perception.stereo import NEAREST, OnnxMatcher, SemiGlobalMatcher, stereo_depth
from dgs_sim_bridge.render.d455 import D455
from dgs_sim_bridge.render.raster import box_mesh
from dgs_sim_bridge.render.shot import Shot, Stage, take_shot
from tests.support.onnx_stereo import write_matcher
from tests.support.refused import refused
from tests.support.stage import camera_pose, table_stage

BASELINE = 0.095
SMALL = PinholeCamera.centred(424, 240, 223.5)


def pair(stage: Stage, T_world_camera: np.ndarray, camera: PinholeCamera = D455) -> Shot:
    return take_shot(stage, camera, T_world_camera, None, np.random.default_rng(0), imagers=2)


def wall(distance: float) -> Shot:
    """A wall that fills the image."""
    stage = Stage([], [], (), box_mesh((-3, -3, distance), (3, 3, distance + 0.1)))
    return pair(stage, np.eye(4))


def depth_of(shot: Shot, camera: PinholeCamera = D455) -> np.ndarray:
    assert shot.left is not None and shot.right is not None
    return stereo_depth(SemiGlobalMatcher(camera, BASELINE), shot.left, shot.right, camera, BASELINE)


@pytest.mark.parametrize(
    ("distance", "share", "error"), [(0.5, 0.99, 0.001), (1.0, 0.97, 0.003), (1.5, 0.8, 0.015)]
)
def test_a_wall_is_where_it_is(distance: float, share: float, error: float) -> None:
    found = depth_of(wall(distance))
    # What the right imager does not see, the band at the left, cannot be matched.
    band = int(np.ceil(D455.fx * BASELINE / distance)) + 3
    seen = found[:, band:]
    assert (seen > 0).mean() > share
    assert np.median(np.abs(seen[seen > 0] - distance)) < error
    assert (found[:, : band // 2] > 0).mean() < 0.5


def test_things_on_a_table_at_1_m() -> None:
    shot = pair(table_stage(), camera_pose())
    found, true = depth_of(shot), shot.truth.depth
    near = (true > 0) & (true < 1.5)
    valid = near & (found > 0)
    assert valid.sum() > 0.93 * near.sum()
    error = np.abs(found - true)
    assert np.median(error[valid]) < 0.0025
    objects = valid & (shot.truth.ids >= 0)
    assert np.median(error[objects]) < 0.004


def test_what_only_one_imager_sees_has_no_depth() -> None:
    """Left-right check: at the left of a thing in front the background is hidden from the right imager."""
    front, back = box_mesh((-0.15, -0.2, 0.6), (0.15, 0.2, 0.7)), box_mesh((-3, -3, 1), (3, 3, 1.1))
    stage = Stage([front], [np.eye(4)], (), back)
    shot = pair(stage, np.eye(4))
    found = depth_of(shot)
    left_edge = int(D455.project(np.array([[-0.15, 0.0, 0.6]]))[0, 0])
    hidden = int(D455.fx * BASELINE * (1 / 0.6 - 1 / 1.0))
    rows = slice(180, 300)
    strip = found[rows, left_edge - hidden + 4 : left_edge - 4]
    right = np.abs(strip - 1.0) < 0.02
    assert right.mean() < 0.4
    np.testing.assert_allclose(np.median(found[rows, left_edge + 20 : left_edge + 60]), 0.6, atol=0.004)


def test_too_near_is_none() -> None:
    found = depth_of(wall(0.6 * NEAREST))
    assert (found > 0).mean() < 0.2


@pytest.mark.parametrize(
    ("size", "channels", "camera"),
    [
        (("height", "width"), 1, SMALL),
        (("height", "width"), 3, SMALL),
        ((256, 448), 1, SMALL),
        ((256, 448), 3, SMALL),
        ((256, 448), 1, D455),
    ],
    ids=["any", "any, colour", "larger", "larger, colour", "smaller: the images are shrunk"],
)
def test_an_onnx_network_of_any_size(tmp_path: Path, size: Any, channels: int, camera: PinholeCamera) -> None:
    shot = pair(table_stage(), camera_pose(), camera)
    matcher = OnnxMatcher(write_matcher(tmp_path / "net.onnx", size, channels=channels))
    assert shot.left is not None and shot.right is not None
    disparity = matcher(shot.left, shot.right)
    near = (shot.truth.depth > 0) & (shot.truth.depth < 1.3)
    near[:, : camera.width // 10] = False
    expected = camera.fx * BASELINE / shot.truth.depth[near]
    assert disparity.shape == shot.left.shape and disparity.dtype == np.float32
    assert np.median(np.abs(disparity[near] - expected)) < 0.5 * camera.width / SMALL.width
    depth = stereo_depth(matcher, shot.left, shot.right, camera, BASELINE)
    assert np.median(np.abs(depth[near] - shot.truth.depth[near])) < 0.025


def test_disparity_grows_by_the_whole_pixels_that_the_image_was_shrunk_to(tmp_path: Path) -> None:
    matcher = OnnxMatcher(write_matcher(tmp_path / "net.onnx", (320, 448)))
    answers = np.full((1, 1, 320, 448), 30.0, np.float32)
    matcher._session = SimpleNamespace(run=lambda *_: [answers])
    image = np.zeros((480, 640), np.uint8)
    columns = round(640 * 320 / 480)  # of 426.7
    np.testing.assert_allclose(matcher(image, image), 30.0 * 640 / columns, rtol=1e-6)
    matcher._session = SimpleNamespace(run=lambda *_: [answers[..., 1:]])
    with refused(ErrorCode.DEPTH_SOURCE, "failed on images of 640 x 480 px"):
        matcher(image, image)


def test_unfit_networks_are_refused_with_a_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "text.onnx").write_text("no network")
    write_matcher(tmp_path / "wide.onnx", channels=4)
    for name, words in (("none", "no stereo network"), ("text", "no ONNX network"), ("wide", "two images")):
        with refused(ErrorCode.DEPTH_SOURCE, words):
            OnnxMatcher(tmp_path / f"{name}.onnx")

    def missing(name: str, *args: Any, **kwargs: Any) -> Any:
        if name == "onnxruntime":
            raise ImportError("No module named 'onnxruntime'")
        return found(name, *args, **kwargs)

    found = builtins.__import__
    monkeypatch.setattr(builtins, "__import__", missing)
    with refused(ErrorCode.DEPTH_SOURCE, "pip install onnxruntime"):
        OnnxMatcher(tmp_path / "wide.onnx")


def test_images_of_other_sizes_are_refused() -> None:
    image = np.zeros((480, 848), np.uint8)
    with refused(ErrorCode.DEPTH_FORMAT, "camera's"):
        stereo_depth(SemiGlobalMatcher(D455, BASELINE), image, image[:, 1:], D455, BASELINE)
