"""Start the suite on an installed ROS 2 Jazzy.

ros2 launch dgs_bringup suite.launch.py                                       all nodes and the simulator
ros2 launch dgs_bringup suite.launch.py mode:=robot                           all nodes but the simulator
ros2 launch dgs_bringup suite.launch.py mode:=replay bag:=/path/to/bag        camera node on a bag, and the planner
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument, EmitEvent, OpaqueFunction, RegisterEventHandler
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchContext, LaunchDescription

MODES = ("simulation", "robot", "replay")
ARGUMENTS = (
    ("mode", "simulation", "simulation, robot or replay", MODES),
    ("params", "", "further parameter file; its values win over config/suite.yaml", None),
    ("bag", "", "rosbag2 folder or file for mode replay", None),
    (
        "camera_source",
        "depth_topics",
        "camera node, mode robot: where depth comes from",
        ("depth_topics", "realsense"),
    ),
    ("hand_interface", "socketcan", "hand driver, mode robot: python-can interface", None),
    ("hand_channel", "can0", "hand driver, mode robot: channel of the interface", None),
    ("hand_port", "29536", "mode simulation: TCP port of the simulated hand's bus", None),
    ("autostart", "false", "begin to clear the table as soon as all is ready", ("true", "false")),
)


def generate_launch_description() -> LaunchDescription:
    """Arguments, then the nodes of the chosen mode."""
    declared = [
        DeclareLaunchArgument(
            name, default_value=default, description=text, choices=list(choices) if choices else None
        )
        for name, default, text, choices in ARGUMENTS
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=_nodes)])


def _nodes(context: LaunchContext) -> list[Any]:
    values = {name: LaunchConfiguration(name).perform(context) for name, *_ in ARGUMENTS}
    actions: list[Any] = []
    for package, executable, overrides in _selection(values):
        node = _node(package, executable, overrides, values["params"])
        # A suite with a dead node helps nobody: the others end too, and the reason stands last in the terminal.
        leave = EmitEvent(event=Shutdown(reason=f"{executable} ended"))
        actions += [node, RegisterEventHandler(OnProcessExit(target_action=node, on_exit=[leave]))]
    return actions


def _selection(values: dict[str, str]) -> list[tuple[str, str, dict[str, Any]]]:
    """Package, executable and the parameters that differ from config/suite.yaml."""
    autostart = {"autostart": values["autostart"] == "true"}
    if values["mode"] == "simulation":
        port = int(values["hand_port"])
        return [
            ("dgs_sim_bridge", "sim_bridge_node", {"hand_port": port}),
            ("dgs_perception", "camera_node", {}),
            ("dgs_hand_driver", "hand_driver_node", {"port": port}),
            ("dgs_grasp_planner", "grasp_planner_node", {}),
            ("dgs_arm_executor", "arm_executor_node", {}),
            ("dgs_bringup", "clear_table", autostart),
        ]
    real = {"use_sim_time": False}
    if values["mode"] == "robot":
        hand = {"interface": values["hand_interface"], "channel": values["hand_channel"]}
        return [
            ("dgs_perception", "camera_node", {**real, "source": values["camera_source"]}),
            ("dgs_hand_driver", "hand_driver_node", {**real, **hand}),
            ("dgs_grasp_planner", "grasp_planner_node", real),
            ("dgs_arm_executor", "arm_executor_node", real),
            ("dgs_bringup", "clear_table", {**real, **autostart}),
        ]
    if not values["bag"]:
        raise RuntimeError("mode:=replay needs bag:=<rosbag2 folder or file>")
    replay = {**real, "source": "rosbag", "bag_path": str(Path(values["bag"]).resolve()), "bag_restamp": True}
    return [("dgs_perception", "camera_node", replay), ("dgs_grasp_planner", "grasp_planner_node", real)]


def _node(package: str, executable: str, overrides: dict[str, Any], params: str) -> Node:
    """One node with the suite's file, then the mode's overrides, then the user's file.

    Name and namespace are given: without both, launch writes the overrides for nodes of any name, and against such
    the file's section for this node would win.
    """
    suite = str(Path(get_package_share_directory("dgs_bringup")) / "config" / "suite.yaml")
    layers: list[Any] = [suite]
    if overrides:
        layers.append(overrides)
    if params:
        layers.append(str(Path(params).resolve()))
    return Node(
        package=package,
        executable=executable,
        name=executable,
        namespace="/",
        parameters=layers,
        output="screen",
        emulate_tty=True,
        sigterm_timeout="6",
    )
