"""The start script and the demo as a user runs them, with an untrained network in place of the trained one."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import pytest
from PIL import Image
from rosbags.highlevel import AnyReader

from tests.dgs_grasp_planner.models import save_eager_model
from tests.support.environment import GUARD, REPO_ROOT, ros_environment

pytestmark = pytest.mark.integration

SCRIPTS = REPO_ROOT / "ros2_ws" / "src" / "dgs_bringup" / "scripts"
NODES = (
    "sim_bridge_node",
    "camera_node",
    "hand_driver_node",
    "grasp_planner_node",
    "arm_executor_node",
    "clear_table",
)


def run(
    script: str, *arguments: object, domain_id: int, cwd: Path, timeout: float = 500.0
) -> subprocess.CompletedProcess[str]:
    """A script from a folder of its own; its whole process group ends with it."""
    process = subprocess.Popen(
        ["bash", str(SCRIPTS / script), "--timeout", str(GUARD), *map(str, arguments)],
        env={**ros_environment(), "ROS_DOMAIN_ID": str(domain_id)},
        cwd=cwd,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        output, _ = process.communicate(timeout=timeout)
    except subprocess.TimeoutExpired:
        process.terminate()  # the script ends its nodes
        output, _ = process.communicate(timeout=60.0)
        pytest.fail(f"{script} did not end within {timeout} s:\n{output}")
    return subprocess.CompletedProcess(process.args, process.returncode, output)


def planner_parameters(path: Path, **values: object) -> Path:
    lines = [f"    {name}: {json.dumps(value)}" for name, value in values.items()]
    path.write_text("\n".join(["grasp_planner_node:", "  ros__parameters:", *lines, ""]))
    return path


def test_the_demo_leaves_a_complete_run_folder(tmp_path: Path, ros_domain_id: int) -> None:
    save_eager_model(tmp_path, "tiny")
    params = planner_parameters(tmp_path / "params.yaml", models_dir=str(tmp_path), model="tiny")
    out = tmp_path / "run 1: it's é 🤏"
    options = ("--seed", 4, "--objects", 2, "--out", out.name, "--params", params, "--time-limit", 8)
    result = run("demo.sh", *options, "--max-attempts", 1, domain_id=ros_domain_id, cwd=tmp_path)
    assert result.returncode == 0, result.stdout
    summary = json.loads((out / "summary.json").read_text())
    assert {"objects", "attempts", "successes", "cleared", "sr", "cr", "seconds", "records"} <= set(summary)
    assert (summary["objects"], summary["seed"]) == (2, 4)
    assert summary["model"].startswith("tiny ")
    for name in ("before.png", "after.png", "grasps.png", "grasps_camera.png", "run.gif"):
        with Image.open(out / name) as image:
            assert min(image.size) >= 200, name
    with AnyReader([out / "clouds"]) as bag:
        assert bag.topics["/dgs/cloud"].msgcount >= 1
    for node in NODES:
        log = (out / "logs" / f"{node}.log").read_text()
        assert "ready" in log, node
        assert "Traceback" not in log, log
    for word in ("predict", "capture", "attempts", "cleared"):
        assert word in result.stdout
    again = run("demo.sh", *options, domain_id=ros_domain_id, cwd=tmp_path)
    assert again.returncode == 2 and "holds a run already" in again.stdout


def test_a_node_that_refuses_to_start_is_named_and_ends_the_others(
    tmp_path: Path, ros_domain_id: int
) -> None:
    params = planner_parameters(tmp_path / "params.yaml", no_such_parameter=1)
    options = ("--mode", "replay", "--bag", REPO_ROOT / "tests/data/table_depth", "--log", tmp_path / "logs")
    result = run("start_suite.sh", *options, "--params", params, domain_id=ros_domain_id, cwd=tmp_path)
    assert result.returncode == 3
    assert "grasp_planner_node ended with exit code 2" in result.stdout
    assert "no_such_parameter" in result.stdout


@pytest.mark.parametrize(
    ("script", "words", "why"),
    [
        ("start_suite.sh", "--mode replay", "--bag"),
        ("start_suite.sh", "--mode", "--mode needs a value"),
        ("start_suite.sh", "--mode sim", "'sim'"),
        ("start_suite.sh", "--bogus", "'--bogus'"),
        ("start_suite.sh", "--timeout abc", "'abc'"),
        ("start_suite.sh", "--timeout 0", "'0'"),
        ("start_suite.sh", "--params none.yaml", "none.yaml"),
        ("start_suite.sh", "--mode replay --bag none", "no bag at"),
        ("demo.sh", "--seed", "--seed needs a value"),
        ("demo.sh", "--bogus", "--bogus"),
        ("demo.sh", "--objects 99", "0 to 30 are possible"),
        ("demo.sh", "--params none.yaml", "none.yaml"),
        ("demo.sh", "--out=/proc/run", "cannot be written to /proc/run/logs"),
        ("start_suite.sh", "--log /proc", "cannot be written to /proc"),
    ],
)
def test_a_wrong_option_is_said_before_anything_starts(
    script: str, words: str, why: str, tmp_path: Path, ros_domain_id: int
) -> None:
    result = run(script, *words.split(), domain_id=ros_domain_id, cwd=tmp_path)
    assert result.returncode == 2, result.stdout
    assert why in result.stdout
    assert "all nodes are ready" not in result.stdout


def test_a_page_that_cannot_start_does_not_end_the_suite(tmp_path: Path, ros_domain_id: int) -> None:
    params = tmp_path / "params.yaml"
    params.write_text("viewer_node:\n  ros__parameters: {port: -1}\n")
    options = ("--mode", "replay", "--bag", REPO_ROOT / "tests/data/table_depth", "--log", tmp_path / "logs")
    result = run("start_suite.sh", *options, "--view", "--params", params, "--", "echo", "the command runs",
                 domain_id=ros_domain_id, cwd=tmp_path)  # fmt: skip
    assert result.returncode == 0, result.stdout
    assert "no live page" in result.stdout
    assert "parameter 'port'" in result.stdout
    assert "the command runs" in result.stdout
