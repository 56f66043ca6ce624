"""package.xml: names exactly those ROS and Python packages that the package's code imports."""

from __future__ import annotations

import ast
import xml.etree.ElementTree as ET

import pytest

from tests.support.environment import REPO_ROOT

SOURCES = REPO_ROOT / "ros2_ws" / "src"
PACKAGES = sorted(p.parent.name for p in SOURCES.glob("*/setup.py"))
ROSDEP = {
    "numpy": "python3-numpy",
    "scipy": "python3-scipy",
    "yaml": "python3-yaml",
    "cv2": "python3-opencv",
    "PIL": "python3-pil",
    "matplotlib": "python3-matplotlib",
    "can": "python3-can",
    "rich": "python3-rich",
}
"""Import name -> rosdep key. What rosdep does not know (torch, pin, ...) stands in requirements/runtime.txt."""
ROS = {"rclpy", "ament_index_python", "launch", "launch_ros", "builtin_interfaces"}
OWN = {"dgs_description", "dgs_interfaces"} | set(PACKAGES)
NOT_IMPORTED = {
    "dgs_bringup": {
        "dgs_perception",
        "dgs_grasp_planner",
        "dgs_arm_executor",
        "dgs_hand_driver",
        "dgs_sim_bridge",
    }
}
"""Packages that are only started."""


def imported(package: str) -> set[str]:
    """Names of manifest entries that the package's code needs."""
    names: set[str] = set()
    for file in (SOURCES / package).resolve().rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.Import):
                names |= {alias.name.split(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                names.add(node.module.split(".")[0])
    messages = {name for name in names if name.endswith(("_msgs", "_srvs", "_interfaces"))}
    return ((names & (ROS | OWN)) | messages | {ROSDEP[n] for n in names & set(ROSDEP)}) - {package}


@pytest.mark.parametrize("package", PACKAGES)
def test_the_manifest_names_what_is_imported(package: str) -> None:
    manifest = ET.parse(SOURCES / package / "package.xml").getroot()
    declared = {entry.text for tag in ("exec_depend", "depend") for entry in manifest.iter(tag)}
    assert declared == imported(package) | NOT_IMPORTED.get(package, set())
