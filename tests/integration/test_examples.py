"""The numbered examples run as they say."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

import numpy as np
import pytest

from dgs_description.camera import PinholeCamera
from dgs_ros.image_msgs import numpy_to_image, pinhole_to_camera_info
from tests.support.environment import REPO_ROOT, run

pytestmark = [pytest.mark.integration, pytest.mark.slow]


def test_every_example_has_a_number_and_is_named_in_the_docs() -> None:
    files = sorted(path.name for path in (REPO_ROOT / "examples").glob("[0-9]*"))
    assert [name[0] for name in files] == list("123456")
    index = (REPO_ROOT / "docs/index.md").read_text()
    assert all(f"`examples/{name}`" in index for name in files)


def test_2_replays_a_bag_and_1_asks_for_grasps(ros_domain_id: int) -> None:
    out = run("bash", "examples/2_replay_a_bag.sh", domain=ros_domain_id)
    assert "grasps in base_link by dgs_net" in out
    assert "score 0." in out


@pytest.mark.parametrize("words", [["1_ask_for_grasps.py"], ["4_pick_at_pixel.py", "424", "240"]])
def test_1_and_4_say_that_the_suite_must_be_started(words: list[str], ros_domain_id: int) -> None:
    out = run(sys.executable, f"examples/{words[0]}", *words[1:], domain=ros_domain_id, code=1)
    assert "nobody serves /predict_grasps" in out and "start the suite" in out


@pytest.mark.parametrize("words", [[], ["a", "b"]])
def test_4_wants_two_numbers(words: list[str]) -> None:
    assert "usage" in run(sys.executable, "examples/4_pick_at_pixel.py", *words, code=2)


def test_3_own_proposer() -> None:
    out = run(sys.executable, "examples/3_own_proposer.py")
    assert "of 8 candidates are left" in out
    assert "contacts 0." in out


@pytest.mark.parametrize("depth", [np.full((4, 6), 900, np.uint16), np.full((4, 6), 0.9, np.float32)])
def test_4_knows_the_units_of_depth_images(depth: np.ndarray) -> None:
    example = runpy.run_path(str(REPO_ROOT / "examples/4_pick_at_pixel.py"))
    info = pinhole_to_camera_info(PinholeCamera.centred(6, 4, 5.0), "eye")
    messages = {"camera_info": info, "image_rect_raw": numpy_to_image(depth, "eye")}
    newest = {"newest": lambda node, kind, topic: messages[topic.rpartition("/")[2]]}
    example["point_at"].__globals__.update(newest)
    assert example["point_at"](None, 5, 3).point.z == pytest.approx(0.9)


def test_5_imports_a_mesh(tmp_path: Path) -> None:
    """From another folder; what the example makes first is imported by its relative path then."""
    script = REPO_ROOT / "examples/5_import_a_mesh.sh"
    run("bash", script, "", "mine", cwd=tmp_path)
    run("bash", script, "mine.ply", "again", cwd=tmp_path)
    assert all((tmp_path / name / "manifest.json").is_file() for name in ("mine", "again"))


def test_6_fine_tunes(tmp_path: Path) -> None:
    run("bash", "examples/6_fine_tune.sh", "models/dataset.npz", tmp_path / "tuned", 1)
    assert (tmp_path / "tuned" / "latest.pt").is_file()
