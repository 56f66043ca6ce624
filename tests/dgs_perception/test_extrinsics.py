"""The camera's pose on disk."""

from __future__ import annotations

import numpy as np
import pytest
import yaml

from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import CAMERA_OPTICAL, CELL, from_rpy
from dgs_perception.extrinsics import load_extrinsics, save_extrinsics
from tests.support.environment import REPO_ROOT
from tests.support.refused import refused

SHIPPED = REPO_ROOT / "dgs_perception" / "config" / "extrinsics.yaml"


def test_the_shipped_file_is_the_cell():
    shipped = load_extrinsics(SHIPPED)
    assert shipped.optical_frame == CAMERA_OPTICAL
    np.testing.assert_allclose(shipped.T_base_camera_optical, CELL.T_base_camera_optical, atol=1e-8)


def test_a_pose_survives_the_file(tmp_path):
    T_base_camera = from_rpy((1.1, -0.4, 0.8), (-2.0, 0.1, 1.4))
    file = tmp_path / "pose.yaml"
    save_extrinsics(file, T_base_camera)
    file.write_text(file.read_text().replace(CAMERA_OPTICAL, "left_optical"))
    loaded = load_extrinsics(file)
    assert loaded.optical_frame == "left_optical"
    np.testing.assert_allclose(loaded.T_base_camera_optical, T_base_camera, atol=1e-8)


def test_camera_link_looks_along_its_x_axis():
    extrinsics = load_extrinsics(SHIPPED)
    forward = extrinsics.T_base_camera_link[:3, 0]
    np.testing.assert_allclose(forward, extrinsics.T_base_camera_optical[:3, 2], atol=1e-12)
    np.testing.assert_allclose(
        extrinsics.T_base_camera_link[:3, 1], -extrinsics.T_base_camera_optical[:3, 0], atol=1e-12
    )


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"parent": "world"}, "given in 'base_link'"),
        ({"child": ""}, "name of the optical frame"),
        ({"child": 5}, "name of the optical frame"),
        ({"position": [0.1, 0.2]}, "position .* 3 finite numbers"),
        ({"position": [0.1, 0.2, float("nan")]}, "position .* 3 finite numbers"),
        ({"position": "here"}, "position .* 3 finite numbers"),
        ({"position": [769.0, 0.0, 683.0]}, "the unit is metres"),
        ({"quaternion_xyzw": [0, 0, 0, 0]}, "norm 0.0000"),
        ({"quaternion_xyzw": [0, 0, 0, 0.99]}, "norm 0.9900"),
        ({"quaternion_xyzw": [0, 0, None, 1]}, "4 finite numbers"),
        ({"rpy": [0, 0, 0]}, "must have the keys"),
        ({"position": ...}, "must have the keys"),
    ],
)
def test_a_wrong_entry_is_refused(tmp_path, change, sentence):
    content = yaml.safe_load(SHIPPED.read_text())
    content["T_base_camera_optical"] |= change
    content["T_base_camera_optical"] = {
        k: v for k, v in content["T_base_camera_optical"].items() if v is not ...
    }
    check_refused(tmp_path, yaml.safe_dump(content), sentence)


@pytest.mark.parametrize("text", ["", "42", "a: [", "T_base_camera_optical: 7", "\udcff"], ids=range(5))
def test_another_file_is_refused(tmp_path, text):
    check_refused(tmp_path, text, "extrinsics file .*pose.yaml")


def check_refused(tmp_path, text, sentence):
    path = tmp_path / "pose.yaml"
    path.write_bytes(text.encode("utf-8", "surrogateescape"))
    with pytest.raises(DgsError, match=sentence) as caught:
        load_extrinsics(path)
    assert caught.value.code == ErrorCode.EXTRINSICS_INVALID == 406


def test_a_missing_file_is_refused(tmp_path):
    with refused(ErrorCode.EXTRINSICS_INVALID, "cannot be read"):
        load_extrinsics(tmp_path / "none.yaml")
