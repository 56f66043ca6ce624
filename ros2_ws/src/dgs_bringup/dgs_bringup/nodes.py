"""Which nodes the suite has, and where their parameters are declared."""

from __future__ import annotations

import importlib
from dataclasses import dataclass


@dataclass(frozen=True)
class NodeInfo:
    """A node of the suite.

    Attributes:
        package: ament package.
        executable: name for `ros2 run`.
        name: of the node in the graph and in parameter files.
        parameters: "module:class" of its parameter dataclass.
        purpose: one line.
    """

    package: str
    executable: str
    name: str
    parameters: str
    purpose: str

    def parameter_class(self) -> type:
        """The dataclass; imports its module."""
        module, name = self.parameters.split(":")
        found: type = getattr(importlib.import_module(module), name)
        return found


NODES = (
    NodeInfo(
        "dgs_sim_bridge",
        "sim_bridge_node",
        "sim_bridge_node",
        "dgs_sim_bridge.sim_bridge_node:SimParameters",
        "The simulated cell behind the interfaces of the real hardware.",
    ),
    NodeInfo(
        "dgs_perception",
        "camera_node",
        "camera_node",
        "dgs_perception.camera_node:CameraParameters",
        "Depth camera, depth topics or a bag to one clean cloud.",
    ),
    NodeInfo(
        "dgs_grasp_planner",
        "grasp_planner_node",
        "grasp_planner_node",
        "dgs_grasp_planner.planner_parameters:PlannerParameters",
        "DGS-Net: whole dexterous grasps for a cloud.",
    ),
    NodeInfo(
        "dgs_arm_executor",
        "arm_executor_node",
        "arm_executor_node",
        "dgs_arm_executor.executor_parameters:ArmExecutorParameters",
        "Reaches, closes, lifts and places: one pick.",
    ),
    NodeInfo(
        "dgs_hand_driver",
        "hand_driver_node",
        "hand_driver_node",
        "dgs_hand_driver.hand_driver_node:HandDriverParameters",
        "Moves the DexHand Pro over its CAN bus.",
    ),
    NodeInfo(
        "dgs_bringup",
        "clear_table",
        "clear_table",
        "dgs_bringup.clear_table_node:ClearTableParameters",
        "The task: pick, look again, until the table is empty.",
    ),
    NodeInfo(
        "dgs_arm_executor",
        "check_extrinsics",
        "check_extrinsics",
        "dgs_arm_executor.check_extrinsics_node:CheckParameters",
        "Compares the observed table with the camera's pose. Not started with the suite.",
    ),
    NodeInfo(
        "dgs_perception",
        "cloud_recorder",
        "cloud_recorder",
        "dgs_perception.cloud_recorder_node:RecorderParameters",
        "Clouds to a rosbag2 folder. Not started with the suite.",
    ),
)
