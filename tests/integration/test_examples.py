"""The numbered examples run as they say."""

from __future__ import annotations

import runpy
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from dgs_interfaces.msg import SimState

from dgs_description.camera import PinholeCamera
from dgs_description.cell import CELL
from dgs_description.frames import apply, inverse
from dgs_ros.base_node import LATCHED
from dgs_ros.image_msgs import numpy_to_image, pinhole_to_camera_info
from dgs_ros.pose_msgs import to_array
from dgs_sim_bridge.render.d455 import D455
from tests.support.environment import GUARD, REPO_ROOT, ros_environment
from tests.support.ros_client import RosClient

pytestmark = [pytest.mark.integration, pytest.mark.slow]

START = REPO_ROOT / "ros2_ws/src/dgs_bringup/scripts/start_suite.sh"
LONG = 500.0


def run(*command: object, domain: int = 0, code: int = 0, cwd: Path = REPO_ROOT) -> str:
    """Output of a command, in the checkout's root; with its errors if its exit code must be another than 0."""
    environment = {**ros_environment(), "ROS_DOMAIN_ID": str(domain)}
    done = subprocess.run(
        [str(word) for word in command],
        cwd=cwd,
        env=environment,
        capture_output=True,
        text=True,
        timeout=LONG,
    )
    assert done.returncode == code, done.stdout + done.stderr
    return done.stdout + (done.stderr if code else "")


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


def test_4_picks_what_is_at_a_pixel(ros_domain_id: int, ros_client: RosClient, tmp_path: Path) -> None:
    suite = subprocess.Popen(
        ["bash", str(START), "--timeout", str(GUARD), "--log", str(tmp_path)],
        env={**ros_environment(), "ROS_DOMAIN_ID": str(ros_domain_id)},
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        assert suite.stdout is not None
        assert any("all nodes are ready" in line for line in suite.stdout)
        state = ros_client.collect(SimState, "/sim/state", 2, qos=LATCHED)[-1]
        places = np.array([to_array(pose.position) for pose in state.poses])
        away = np.linalg.norm(places[:, None] - places, axis=-1) + np.eye(len(places))
        chosen = int(np.argmax(away.min(axis=1)))
        ((u, v),) = np.rint(
            D455.project(apply(inverse(CELL.T_base_camera_optical), places[[chosen]]))
        ).astype(int)
        for outside in ((5000, 240), (-5, 240)):
            out = run(sys.executable, "examples/4_pick_at_pixel.py", *outside, domain=ros_domain_id, code=1)
            assert f"pixel {outside} is outside of the image" in out
        out = run(sys.executable, "examples/4_pick_at_pixel.py", u, v, domain=ros_domain_id)
        assert out.startswith(("0: ", "219: ", "220: ")), "it was picked, or slipped"
        after = ros_client.collect(SimState, "/sim/state", 2, qos=LATCHED)[-1]
        others = [k for k in range(len(places)) if k != chosen]
        assert [after.places[k] for k in others] == [state.places[k] for k in others]
    finally:
        suite.terminate()
        suite.wait(60.0)


def test_5_imports_a_mesh(tmp_path: Path) -> None:
    """From another folder; what the example makes first is imported by its relative path then."""
    script = REPO_ROOT / "examples/5_import_a_mesh.sh"
    run("bash", script, "", "mine", cwd=tmp_path)
    run("bash", script, "mine.ply", "again", cwd=tmp_path)
    assert all((tmp_path / name / "manifest.json").is_file() for name in ("mine", "again"))


def test_6_fine_tunes(tmp_path: Path) -> None:
    run("bash", "examples/6_fine_tune.sh", "models/dataset.npz", tmp_path / "tuned", 1)
    assert (tmp_path / "tuned" / "latest.pt").is_file()
