"""Start the suite on an installed ROS 2 Jazzy.

ros2 launch dgs_bringup suite.launch.py                                       all nodes and the simulator
ros2 launch dgs_bringup suite.launch.py mode:=robot                           all nodes but the simulator
ros2 launch dgs_bringup suite.launch.py mode:=replay bag:=/path/to/bag        camera node on a bag, and the planner
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument, OpaqueFunction, RegisterEventHandler
from launch.event_handlers import OnProcessExit
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from dgs_bringup.nodes import MODES, ROBOT_STATE, VIEWER, NodeInfo
from dgs_bringup.suite_file import check
from launch import LaunchContext, LaunchDescription

ARGUMENTS = (
    ("mode", "simulation", "simulation, robot or replay"),
    ("params", "", "further parameter file; its values win over config/suite.yaml"),
    ("bag", "", "rosbag2 folder or file for mode replay"),
    ("camera_source", "depth_topics", "mode robot: where depth comes from, depth_topics or realsense"),
    ("hand_interface", "socketcan", "mode robot: python-can interface of the hand driver"),
    ("hand_channel", "can0", "mode robot: channel of that interface"),
    ("view", "false", "also the live page, and (not in mode robot) the frames for RViz: true or false"),
    ("autostart", "false", "begin to clear the table as soon as all is ready: true or false"),
)
GENERAL = ("launch-prefix", "launch-prefix-filter", "emulate_tty", "sigterm_timeout", "sigkill_timeout")
"""Arguments of any launch file, which launch itself reads."""


def generate_launch_description() -> LaunchDescription:
    """Arguments, then the nodes of the chosen mode."""
    declared = [DeclareLaunchArgument(n, default_value=d, description=text) for n, d, text in ARGUMENTS]
    return LaunchDescription([*declared, OpaqueFunction(function=_nodes)])


def _nodes(context: LaunchContext) -> list[Any]:
    _refuse_unknown(context)
    values = {name: LaunchConfiguration(name).perform(context) for name, *_ in ARGUMENTS}
    if values["mode"] not in MODES:
        raise RuntimeError(f"mode:={values['mode']} is none of {', '.join(MODES)}")
    for name in ("view", "autostart"):
        values[name] = values[name].lower()
        if values[name] not in ("true", "false"):
            raise RuntimeError(f"{name}:={values[name]} is neither true nor false")
    overrides = _overrides(values)
    actions: list[Any] = []
    for info in MODES[values["mode"]]:
        node = _node(info, overrides.get(info.name, {}), values)
        actions += [node, RegisterEventHandler(OnProcessExit(target_action=node, on_exit=_leave(info.name)))]
    if values["view"] == "true":  # nobody depends on it
        actions.append(_node(VIEWER, {"simulated": values["mode"] == "simulation"}, values))
        if values["mode"] != "robot":  # whose driver has a robot_state_publisher
            actions.append(_node(ROBOT_STATE, {}, values))
    return actions


def _refuse_unknown(context: LaunchContext) -> None:
    """Refuse a misspelt argument, of which launch says nothing; a file that includes this one may have more."""
    if Path(__file__).name not in (Path(word).name for word in sys.argv):
        return
    known = [name for name, *_ in ARGUMENTS]
    for word in context.argv:
        name = word.partition(":=")[0]
        if name not in known and name not in GENERAL:
            raise RuntimeError(f"{word}: there is no argument {name}; there are {', '.join(known)}")


def _leave(name: str) -> Callable[[Any, LaunchContext], None]:
    """What is done when a node ends: a suite with a dead node helps nobody, the others end too.

    An exception is launch's way to an exit code other than 0.
    """

    def leave(event: Any, context: LaunchContext) -> None:
        if not context.is_shutdown:
            raise RuntimeError(f"{name} has ended with exit code {event.returncode}: the others end, too")

    return leave


def _overrides(values: dict[str, str]) -> dict[str, dict[str, Any]]:
    """Parameters of the mode that differ from config/suite.yaml, by node."""
    task = {"clear_table": {"autostart": values["autostart"] == "true"}}
    if values["mode"] == "simulation":
        return task
    if values["mode"] == "robot":
        hand = {"interface": values["hand_interface"], "channel": values["hand_channel"]}
        return {**task, "camera_node": {"source": values["camera_source"]}, "hand_driver_node": hand}
    if not values["bag"]:
        raise RuntimeError("mode:=replay needs bag:=<rosbag2 folder or file>")
    bag = {"source": "rosbag", "bag_path": str(Path(values["bag"]).resolve()), "bag_restamp": True}
    return {"camera_node": bag}


def _node(info: NodeInfo, overrides: dict[str, Any], values: dict[str, str]) -> Node:
    """One node with the suite's file, then the mode's overrides, then the user's file.

    Name and namespace are given: without both, launch writes the overrides for nodes of any name, and against such
    the file's section for this node would win.
    """
    suite = str(Path(get_package_share_directory("dgs_bringup")) / "config" / "suite.yaml")
    layers: list[Any] = [suite, {"use_sim_time": values["mode"] == "simulation", **overrides}]
    if values["params"]:
        check(Path(values["params"]))
        layers.append(str(Path(values["params"]).resolve()))
    return Node(
        package=info.package,
        executable=info.name,
        name=info.name,
        namespace="/",
        parameters=layers,
        output="screen",
        emulate_tty=True,
        sigterm_timeout="6",
    )
