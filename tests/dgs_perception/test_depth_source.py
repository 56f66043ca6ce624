"""The sources of depth by their names."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from dgs_description.errors import ErrorCode
from dgs_perception.depth_source import DepthSource
from dgs_sim_bridge.render.d455 import D455, D455Noise
from dgs_sim_bridge.render.shot import take_shot
from tests.support.onnx_stereo import write_matcher
from tests.support.refused import refused
from tests.support.stage import camera_pose, table_stage

SHOT = take_shot(table_stage(), D455, camera_pose(), D455Noise(), np.random.default_rng(0), imagers=2)


@pytest.mark.parametrize(
    ("name", "imagers", "needs_depth"), [("raw", 0, True), ("completed", 1, True), ("stereo", 2, False)]
)
def test_every_source_says_what_it_needs_and_gives_depth(name: str, imagers: int, needs_depth: bool) -> None:
    source = DepthSource(name)
    assert (source.imagers, source.needs_depth) == (imagers, needs_depth)
    depth = SHOT.depth if needs_depth else None
    left, right = (image if k < imagers else None for k, image in enumerate((SHOT.left, SHOT.right)))
    found = source(depth, left, right, D455, 0.095)
    near = (SHOT.truth.depth > 0) & (SHOT.truth.depth < 1.3) & (found > 0)
    assert found.shape == (480, 848) and found.dtype == np.float32 and near.mean() > 0.3
    assert np.median(np.abs(found - SHOT.truth.depth)[near]) < 0.005


def test_the_cameras_depth_is_not_touched() -> None:
    assert DepthSource("raw")(SHOT.depth, None, None, D455, 0.0) is SHOT.depth


def test_a_file_is_a_stereo_network(tmp_path: Path) -> None:
    source = DepthSource(str(write_matcher(tmp_path / "net.onnx")))
    assert (source.imagers, source.needs_depth) == (2, False)
    assert (source(None, SHOT.left, SHOT.right, D455, 0.095) > 0).mean() > 0.5


@pytest.mark.parametrize(
    ("name", "code"),
    [
        ("glass", ErrorCode.PARAMETER_INVALID),
        ("", ErrorCode.PARAMETER_INVALID),
        ("no.onnx", ErrorCode.DEPTH_SOURCE),
    ],
)
def test_others_are_refused(name: str, code: ErrorCode) -> None:
    with refused(code):
        DepthSource(name)


def test_the_cameras_depth_loads_neither_torch_nor_onnxruntime_nor_opencv() -> None:
    code = (
        "import sys; from dgs_perception.depth_source import DepthSource; DepthSource('raw'); "
        "assert not {'torch', 'onnxruntime', 'cv2'} & set(sys.modules), sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True, env={"PYTHONPATH": ":".join(sys.path)})
