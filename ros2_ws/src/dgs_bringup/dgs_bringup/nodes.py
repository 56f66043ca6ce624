"""Which nodes the suite has: what they are started as, what they offer, where their parameters are declared."""

from __future__ import annotations

from dataclasses import dataclass
from pkgutil import resolve_name


@dataclass(frozen=True)
class NodeInfo:
    """A node of the suite.

    Attributes:
        package: ament package.
        name: of the executable, of the node in the graph and in parameter files.
        parameters: "module:class" of its parameter dataclass, in the package.
        offers: services, actions and topics by which its presence is known.
    """

    package: str
    name: str
    parameters: str
    offers: tuple[str, ...]

    def parameter_class(self) -> type:
        """The dataclass; imports its module."""
        return resolve_name(f"{self.package}.{self.parameters}")


SIMULATOR = NodeInfo(
    "dgs_sim_bridge", "sim_bridge_node", "sim_bridge_node:SimParameters", ("/sim/reset", "/sim/inject_fault")
)
CAMERA = NodeInfo("dgs_perception", "camera_node", "camera_node:CameraParameters", ("/dgs/cloud",))
PLANNER = NodeInfo(
    "dgs_grasp_planner", "grasp_planner_node", "planner_parameters:PlannerParameters", ("/predict_grasps",)
)
ARM = NodeInfo(
    "dgs_arm_executor",
    "arm_executor_node",
    "executor_parameters:ArmExecutorParameters",
    ("/execute_grasp", "/go_home", "/stop", "/reset"),
)
HAND = NodeInfo(
    "dgs_hand_driver", "hand_driver_node", "hand_driver_node:HandDriverParameters", ("/dexhand/move",)
)
TASK = NodeInfo("dgs_bringup", "clear_table", "clear_table:ClearTableParameters", ("/clear_table",))
VIEWER = NodeInfo("dgs_viewer", "viewer_node", "viewer_node:ViewerParameters", ())
ROBOT_STATE = NodeInfo("dgs_bringup", "robot_state", "robot_state_node:RobotStateParameters", ())
CHECK = NodeInfo("dgs_arm_executor", "check_extrinsics", "check_extrinsics_node:CheckParameters", ())
RECORDER = NodeInfo("dgs_perception", "cloud_recorder", "cloud_recorder_node:RecorderParameters", ())

NODES = (SIMULATOR, CAMERA, PLANNER, ARM, HAND, TASK, VIEWER, ROBOT_STATE, CHECK, RECORDER)
MODES = {
    "simulation": (SIMULATOR, CAMERA, HAND, PLANNER, ARM, TASK),
    "robot": (CAMERA, HAND, PLANNER, ARM, TASK),
    "replay": (CAMERA, PLANNER),
}
"""What `start_suite.sh` and the launch file start."""


def who_offers(name: str) -> str:
    """Name of the node that offers a service, action or topic; "?" if none of the suite does."""
    return next((node.name for node in NODES if name in node.offers), "?")
