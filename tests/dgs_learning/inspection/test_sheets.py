"""Contact sheets of grasps and scenes, and the command that writes them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image

from dgs_description.frames import apply
from dgs_description.hand import HAND
from dgs_learning.dataset import finger_pattern
from dgs_learning.inspection.grasp_sheet import choose, draw_grasp, grasp_sheet
from dgs_learning.inspection.scene_sheet import MIN_DISTANCE, spread_out
from dgs_sim_bridge.render.meshes import hand_parts
from dgs_sim_bridge.render.pictures import BACKGROUND
from tests.dgs_learning.small_dataset import small_dataset, small_dataset_file
from tests.support.commands import dgs


def test_drawn_hand_has_the_shape_of_the_model() -> None:
    joints = np.tile([0.1, 0.6, 0.5, 0.5], 5)
    spheres = HAND.finger_spheres(joints)
    for part in hand_parts(joints):
        vertices = apply(part.T_tcp_part, part.mesh[0])
        if part.finger >= 0:
            gap = np.linalg.norm(vertices[:, None] - spheres[part.finger][None], axis=-1) - HAND.sphere_radii
            assert 0 <= gap.min(1).max() < 0.0025, "the capsule leaves the spheres that stand for it"


def test_picture_shows_object_and_hand() -> None:
    data = small_dataset()
    picture = draw_grasp(data.objects[0], data.grasps[0])
    assert picture.dtype == np.uint8 and picture.shape[2] == 3
    background = (np.abs(picture.astype(int) - np.array(BACKGROUND)) < 3).all(-1).mean()
    assert 0.3 < background < 0.9
    red_over_blue = picture[..., 0].astype(int) - picture[..., 2]
    assert (red_over_blue > 60).mean() > 0.01, "the orange block"
    assert (red_over_blue < -40).mean() > 0.02, "the blue fingers"


def test_sheet_prefers_other_objects_and_leaves_out_empty_classes(tmp_path: Path) -> None:
    data = small_dataset()
    rows = choose(data, "cuboid", 3, 0)
    assert len(set(rows)) == len(rows) and max(rows) < data.first[1]
    assert not grasp_sheet(tmp_path / "bowl.png", data, "bowl") and not list(tmp_path.iterdir())


def test_grasps_of_four_fingers_are_drawn_too() -> None:
    data = small_dataset()
    active = np.tile(finger_pattern(4), (len(data.grasps), 1))
    level = replace(data, grasps=replace(data.grasps, active_fingers=active))
    assert len(choose(level, "cuboid", 3, 0)) == 3


def test_hands_in_a_scene_stand_apart() -> None:
    rng = np.random.default_rng(0)
    position = rng.uniform(-0.2, 0.2, (60, 3))
    chosen = position[spread_out(position, rng)]
    gaps = np.linalg.norm(chosen[:, None] - chosen[None], axis=-1)[~np.eye(len(chosen), dtype=bool)]
    assert len(chosen) == 4 and gaps.min() > MIN_DISTANCE


def test_command_writes_json_and_pages(tmp_path: Path) -> None:
    out = tmp_path / "i.json"
    words = ["inspect", str(small_dataset_file()), "--json", str(out), "--pictures", str(tmp_path)]
    dgs([*words, "--per-class", "2", "--scenes", "1"])
    keys = {"objects", "object_scales", "stage1_grasps", "scenes", "scene_grasps", "by_class"}
    assert keys <= json.loads(out.read_text()).keys()
    pages = sorted(path.name for path in tmp_path.glob("*.png"))
    assert pages == ["grasps_cuboid.png", "grasps_cylinder.png", "scenes.png"]
    assert all(min(Image.open(tmp_path / page).size) > 200 for page in pages)
