"""docs/hand.md and docs/cell.md say what the code says."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from dgs_description import arm_kinematics, diagram, joints, urdf
from dgs_description.cell import CELL
from dgs_description.hand import CHOICE, HAND
from dgs_description.urdf_parts import fingers, palm_link

DOCS = Path(__file__).resolve().parents[2] / "docs"
HAND_TEXT, CELL_TEXT = (DOCS / "hand.md").read_text(), (DOCS / "cell.md").read_text()


def rows(text: str, first: str) -> list[str]:
    """Cells of the table row that starts with `first`."""
    (line,) = [line for line in text.splitlines() if line.startswith(f"| {first} |")]
    return [cell.strip() for cell in line.strip("|").split("|")]


def numbers(text: str) -> list[float]:
    return [float(found) for found in re.findall(r"-?\d+(?:\.\d+)?", text)]


@pytest.mark.parametrize("k", range(4))
def test_joint_limits(k: int) -> None:
    expected = [float(values[k]) for values in (HAND.lower, HAND.upper, HAND.effort)]
    assert [float(cell) for cell in rows(HAND_TEXT, f"joint{k + 1}")[2:]] == expected


@pytest.mark.parametrize("f", range(5))
def test_finger_bases(f: int) -> None:
    text = HAND_TEXT.split("## Joints")[0]
    cells = rows(text, HAND.fingers[f])
    found = [float(cell) for cell in cells[1:4]]
    np.testing.assert_allclose(found, HAND.bases[f, :3, 3] * 1e3, atol=0.006)
    if f > 0:
        palmar = HAND.bases[f, :3, 2]
        assert float(cells[4]) == pytest.approx(np.rad2deg(np.arctan2(palmar[1], palmar[0])), abs=1e-6)


def test_tcp_and_speed() -> None:
    x, y, z = HAND.T_base_tcp[:3, 3] * 1e3
    assert f"at ({x:g}, {y:g}, {z:g}) mm in `hand_base`" in HAND_TEXT
    assert f"{HAND.T_mount_base[2, 3] * 1e3:g} mm in front of it" in HAND_TEXT
    assert f"Speed limit {HAND.speed:g} rad/s" in HAND_TEXT


def test_masses() -> None:
    text = HAND_TEXT.split("## Masses")[1]
    assert float(rows(text, "palm")[1]) == palm_link().mass
    thumb = {
        link.name.removeprefix("thumb_"): link.mass
        for link in fingers().links
        if link.name.startswith("thumb")
    }
    for phalanx in ("knuckle", "proximal", "middle", "distal"):
        assert float(rows(text, phalanx)[1]) == thumb[phalanx]


def test_urdf_files() -> None:
    table = HAND_TEXT.split("## URDF files")[1]
    assert set(re.findall(r"^\| (.*?) \|", table, flags=re.M)[1:]) == {
        *(f"`{name}`" for name in urdf.NAMES if not name.endswith("_ros")),
        ", ".join(f"`{name}`" for name in urdf.NAMES if name.endswith("_ros")),
    }


def test_cell_coordinates() -> None:
    table = re.findall(r"^\| [^|]+ \| `(\w+)` \| ([^|]+) \|", CELL_TEXT, flags=re.M)
    named = {field for field, _ in table}
    assert named == set(CELL.__dataclass_fields__)
    for field, value in table:
        if field in ("camera_position", "camera_quaternion_xyzw", "optical_frame"):
            assert value == (getattr(CELL, field) or "–"), field
            continue
        assert numbers(value) == np.round(np.atleast_1d(getattr(CELL, field)), 3).tolist(), field
    assert f"{np.rad2deg(CELL.camera_elevation):.0f} degrees above the table's plane" in CELL_TEXT
    x, y, z = CELL.T_base_camera_optical[:3, 3] + 0.0
    assert f"({x:.4f}, {y:g}, {z:.4f})" in CELL_TEXT


def test_dh_table() -> None:
    for k, joint in enumerate(joints.ARM_JOINTS):
        _, a, d, alpha = rows(CELL_TEXT, joint)
        assert (float(a), float(d)) == (arm_kinematics.DH_A[k], arm_kinematics.DH_D[k])
        assert {"pi/2": np.pi / 2, "-pi/2": -np.pi / 2, "0": 0.0}[alpha] == arm_kinematics.DH_ALPHA[k]


def test_the_picture_is_small_and_drawn_by_the_command(tmp_path: Path) -> None:
    picture = DOCS / "images" / "hand_frames.png"
    assert picture.stat().st_size < 150_000
    assert "images/hand_frames.png" in HAND_TEXT
    diagram.draw(tmp_path / "hand.png")
    pixels = [diagram.plt.imread(path) for path in (picture, tmp_path / "hand.png")]
    assert pixels[0].shape == pixels[1].shape
    # Fonts may differ a little between machines; the hand may not.
    assert np.abs(pixels[0] - pixels[1]).mean() < 0.01


def test_no_other_hand_is_drawn_as_the_default_one(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "dgs_description.diagram", str(tmp_path / "hand.png")]
    environment = os.environ | {CHOICE: "allegro"}
    ended = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120)
    assert ended.returncode == 1 and f"unset {CHOICE}" in ended.stderr
    assert not list(tmp_path.iterdir())
