"""`check_extrinsics` on the simulated camera: the right pose of the camera, and wrong ones."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import PointCloud2

from dgs_description.cell import CELL, CHOICE, save_camera
from dgs_description.errors import ErrorCode
from dgs_description.frames import from_rpy
from tests.support.environment import reserved_domain_id
from tests.support.processes import NodeProcess, suite_node
from tests.support.ros_client import RosClient

pytestmark = pytest.mark.integration

POSES = {
    "right": np.eye(4),
    "tilted": from_rpy((0.0, 0.0, 0.0), (np.deg2rad(2.5), 0.0, 0.0)),
    "far": from_rpy((0.0, 0.0, 0.06), (0.0, 0.0, 0.0)),
}
"""Errors of the camera's pose, in its own frame."""


@pytest.fixture(scope="module")
def domain(tmp_path_factory: pytest.TempPathFactory) -> Iterator[int]:
    """One simulator and, per pose, one camera node with clouds of its own."""
    folder = tmp_path_factory.mktemp("extrinsics")
    with reserved_domain_id() as domain, RosClient(domain) as client:
        cameras = [_camera(folder, domain, name, error) for name, error in POSES.items()]
        sim = suite_node("sim_bridge_node", domain, folder, {"hand_port": 0, "objects": 5, "seed": 4})
        with sim, cameras[0], cameras[1], cameras[2]:
            for name, camera in zip(POSES, cameras, strict=True):
                clouds: list[PointCloud2] = []
                subscription = client.node.create_subscription(
                    PointCloud2, f"/{name}", clouds.append, qos_profile_sensor_data
                )
                camera.wait_ready(lambda clouds=clouds: clouds)
                client.node.destroy_subscription(subscription)
            yield domain


def _camera(folder: Path, domain: int, name: str, error: np.ndarray) -> NodeProcess:
    file = folder / f"{name}.yaml"
    save_camera(file, CELL.T_base_camera_optical @ error)
    return suite_node(
        "camera_node",
        domain,
        folder / name,
        {"use_sim_time": True},
        environment={CHOICE: str(file)},
        remappings={"/dgs/cloud": f"/{name}", "__node": f"camera_{name}"},
    )


def check(domain: int, folder: Path, topic: str, timeout: float = 60.0) -> tuple[int, str]:
    """Exit code and output of the command."""
    process = suite_node(
        "check_extrinsics", domain, folder, {"cloud_topic": topic, "clouds": 2, "timeout": timeout}
    )
    with process:
        return process.wait(), process.log()


def test_the_right_pose_agrees_with_the_table(domain: int, tmp_path: Path) -> None:
    code, output = check(domain, tmp_path, "/right")
    assert code == 0, output
    assert "deg" in output and "mm" in output and "agrees" in output


@pytest.mark.parametrize("name", ["tilted", "far"])
def test_a_wrong_pose_is_refused_with_its_code(domain: int, tmp_path: Path, name: str) -> None:
    code, output = check(domain, tmp_path, f"/{name}")
    assert code == 1, output
    assert str(int(ErrorCode.EXTRINSICS_OFF)) in output


def test_ctrl_c_ends_the_wait_for_clouds_without_a_traceback(tmp_path: Path) -> None:
    with (
        reserved_domain_id() as domain,
        RosClient(domain) as client,
        suite_node("check_extrinsics", domain, tmp_path, {"timeout": 60.0}) as process,
    ):
        process.wait_ready(lambda: client.node.count_subscribers("/dgs/cloud"))
        assert process.interrupt() == 2 and "Traceback" not in process.log()


def test_without_clouds_there_is_no_answer(domain: int, tmp_path: Path) -> None:
    code, output = check(domain, tmp_path, "/nobody", timeout=1.0)
    assert code == 2 and str(int(ErrorCode.CAMERA_SILENT)) in output
