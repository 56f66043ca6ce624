"""The cell, its file, and all parts in another cell than the default one."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml

from dgs_arm_executor.view import seen_at_home
from dgs_description.cell import CELL, CHOICE, HOME_ARM, Cell, load_cell, save_camera
from dgs_description.errors import ErrorCode
from dgs_description.frames import from_rpy
from tests.support.refused import refused

OTHER = {
    "table_height": -0.15,
    "workspace_size": [0.36, 0.60],
    "workspace_height": 0.24,
    "bin_centre": [-0.12, -0.40],
    "camera_position": [0.75, 0.15, 0.70],
    "camera_quaternion_xyzw": [0.5659, 0.7851, -0.2042, -0.1472],
}


def write(path: Path, content: object) -> Path:
    path.write_text(content if isinstance(content, str) else yaml.safe_dump(content))
    return path


def test_a_file_changes_what_it_names(tmp_path: Path) -> None:
    cell = load_cell(write(tmp_path / "cell.yaml", OTHER))
    assert cell.table_height == -0.15 and cell.table_size == CELL.table_size
    assert cell.tcp_bounds[0][2] == pytest.approx(-0.17), "follows the table"
    np.testing.assert_allclose(cell.T_base_camera_optical[:3, 3], OTHER["camera_position"])
    assert load_cell(write(tmp_path / "same.yaml", "")) == CELL == Cell()
    np.testing.assert_array_equal(HOME_ARM, CELL.home)


def test_a_measured_camera_is_written_beside_the_rest(tmp_path: Path) -> None:
    T_base_camera = from_rpy((1.1, -0.4, 0.8), (-2.4, 0.1, 1.1))
    path = write(tmp_path / "cell.yaml", {"table_height": -0.3, "optical_frame": "left_optical"})
    save_camera(path, T_base_camera)
    save_camera(tmp_path / "new.yaml", T_base_camera)
    for cell in (load_cell(path), load_cell(tmp_path / "new.yaml")):
        np.testing.assert_allclose(cell.T_base_camera_optical, T_base_camera, atol=1e-8)
    assert load_cell(path).table_height == -0.3 and load_cell(path).optical_frame == "left_optical"


@pytest.mark.parametrize(
    "before",
    [
        "# ours\ntable_height: -0.3  # measured\n",
        "camera_quaternion_xyzw: [1.0, 0.0,\n  0.0, 0.0]\n# ours\ntable_height: -0.3  # measured\ncamera_position:\n"
        "  - 0.0\n  - 0.0\n  - 0.7\n",
        "camera_position:\n- 0.0\n- 0.0\n- 0.7\n# ours\ntable_height: -0.3  # measured\n"
        "camera_quaternion_xyzw: [1.0, 0.0, 0.0, 0.0]\n",
        "{table_height: -0.3}",
        "--- {table_height: -0.3}\n...\n",
    ],
)
def test_what_else_is_in_the_file_stays_as_it_was_written(tmp_path: Path, before: str) -> None:
    path = write(tmp_path / "cell.yaml", before)
    T_base_camera = from_rpy((1.1, -0.4, 0.8), (-2.4, 0.1, 1.1))
    for _ in range(2):
        save_camera(path, T_base_camera)
        cell = load_cell(path)
        np.testing.assert_allclose(cell.T_base_camera_optical, T_base_camera, atol=1e-8)
        assert cell.table_height == -0.3
        text = path.read_text()
        assert text.count("camera_position") == text.count("camera_quaternion_xyzw") == 1
        assert "{" in before or "# ours\ntable_height: -0.3  # measured\n" in text


@pytest.mark.parametrize("before", ["{}", "", "# nothing yet\n"])
def test_a_camera_comes_into_an_empty_file(tmp_path: Path, before: str) -> None:
    path = write(tmp_path / "cell.yaml", before)
    save_camera(path, CELL.T_base_camera_optical)
    np.testing.assert_allclose(load_cell(path).T_base_camera_optical, CELL.T_base_camera_optical, atol=1e-8)
    assert path.read_text().startswith(before.strip("{}"))


@pytest.mark.parametrize("width", [0.36, 0.44, 0.54, 0.66])
def test_a_workspace_may_reach_to_the_tables_edge(width: float) -> None:
    """Whatever the last bit of a sum says."""
    centre = Cell.table_centre[0] - Cell.table_size[0] / 2 + width / 2
    Cell(workspace_size=(width, 0.8), workspace_centre=(round(centre, 4), 0.0), bin_centre=(-0.12, -0.42))


def test_camera_link_looks_along_its_x_axis() -> None:
    np.testing.assert_allclose(CELL.T_base_camera_link[:3, 0], CELL.T_base_camera_optical[:3, 2], atol=1e-12)
    np.testing.assert_allclose(CELL.T_base_camera_link[:3, 1], -CELL.T_base_camera_optical[:3, 0], atol=1e-12)
    assert CELL.T_base_camera_link[2, 2] > 0, "z up"


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        ("42", "must hold entries"),
        ("a: [", "cannot be read"),
        ({"table_hight": 0.1}, "unknown entry 'table_hight'; there are table_height, "),
        ({"table_height": "low"}, "table_height: 'low'; it must be a finite number"),
        ({"table_height": float("nan")}, "must be a finite number"),
        ({"table_size": [1.0, 1.0]}, "must be 3 finite numbers"),
        ({"home": [0.0] * 5}, "must be 6 finite numbers"),
        ({"optical_frame": ""}, "must be a name"),
        ({"optical_frame": "/camera_link"}, "optical_frame cannot be camera_link"),
        ({"table_size": [1.0, 1.0, 0.0]}, "sizes and distances must be greater than 0"),
        ({"free_edge": [0.4, 0.1]}, "0.4 must be less than 0.1"),
        ({"workspace_centre": [0.2, 0.0]}, "workspace must lie on the table"),
        ({"turning_edge": [0.05, 0.35]}, "turning_edge must lie in free_edge"),
        ({"table_size": [0.7, 0.7, 0.04], "workspace_size": [0.4, 0.6]}, "free_edge must lie on the table"),
        ({"bin_centre": [-0.1, -0.75]}, "over the bin's middle"),
        ({"bin_centre": [0.2, -0.45]}, "bin must stand beside workspace and robot"),
        ({"bin_centre": [-0.1, -0.1]}, "bin must stand beside workspace and robot"),
        ({"table_height": 2.0}, "1.98 must be less than 1"),
        ({"floor_height": 0.92}, "floor must lie below robot and table top"),
        ({"floor_height": -0.21}, "floor must lie below robot and table top"),
        ({"bin_wall": 0.12}, "bin's walls leave no room"),
        ({"table_height": True}, "must be a finite number"),
        ({"home": [-100, -110, 100, -80, -90, 0]}, "home is beyond .* the unit is radians"),
        ({"camera_elevation": 62.0}, "the unit is radians"),
        ({"camera_distance": 100.0}, "over 10 m away; the unit is metres"),
        ({"camera_position": [0.7, 0.0, 0.7]}, "go together"),
        (
            {"camera_position": [0, 0, 1], "camera_quaternion_xyzw": [0, 0, 0, 1]},
            "looks away from the workspace",
        ),
        ("table_height: 2026-13-45", "cannot be read"),
        ({"table_height": 10**400}, "must be a finite number"),
        ({"camera_position": [0.1, 0.2]}, "must be 3 finite numbers"),
        (
            {"camera_position": [769.0, 0.0, 683.0], "camera_quaternion_xyzw": [1, 0, 0, 0]},
            "the unit is metres",
        ),
        ({"camera_position": [0, 0, 1], "camera_quaternion_xyzw": [0, 0, 0, 0]}, "norm 0.0000"),
        ({"camera_position": [0, 0, 1], "camera_quaternion_xyzw": [0, 0, 0, 0.99]}, "norm 0.9900"),
    ],
)
def test_a_cell_that_cannot_be_is_refused(tmp_path: Path, content: object, sentence: str) -> None:
    with refused(ErrorCode.PARAMETER_INVALID, sentence):
        load_cell(write(tmp_path / "cell.yaml", content))


def test_a_missing_file_ends_every_program_with_a_sentence(tmp_path: Path) -> None:
    with refused(ErrorCode.DESCRIPTION_MISSING, "no cell at"):
        load_cell(tmp_path / "none.yaml")
    with refused(ErrorCode.PARAMETER_INVALID, "cannot be read"):
        load_cell(tmp_path / ("long" * 100))
    ended = run(tmp_path / "none.yaml", sys.executable, "-c", "import dgs_description.cell")
    assert ended.returncode == 2 and ended.stderr.startswith(f"{CHOICE}: no cell at")


def run(cell: Path, *words: object) -> subprocess.CompletedProcess[str]:
    command = [str(word) for word in words]
    environment = os.environ | {CHOICE: str(cell)}
    return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=240)


def test_a_home_that_the_camera_sees_is_told(tmp_path: Path) -> None:
    code = "from dgs_arm_executor.view import seen_at_home; print('seen:', seen_at_home())"
    high = run(write(tmp_path / "high.yaml", {"table_height": -0.15}), sys.executable, "-c", code)
    other = run(write(tmp_path / "other.yaml", OTHER), sys.executable, "-c", code)
    assert (
        high.stdout.splitlines()[-1] == "seen: upper_arm_link" and other.stdout.splitlines()[-1] == "seen: "
    )
    assert seen_at_home() == ""


def test_in_another_cell_camera_planner_arm_and_simulator_agree(tmp_path: Path) -> None:
    cell, out = write(tmp_path / "cell.yaml", OTHER), tmp_path / "run"
    words = "dgs evaluate --arm --rehearse --scenes 1 --objects-per-scene 3 --seed 1 --workers 1"
    ended = run(cell, *words.split(), "--out", out)
    assert ended.returncode == 0, ended.stderr
    found = json.loads((out / "summary.json").read_text())
    assert found["cleared"] == found["objects"] == 3, found["per_scene"]
