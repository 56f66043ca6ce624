"""Parameters of the grasp planner node, and the settings of the stages that they make up."""

from __future__ import annotations

from dataclasses import dataclass

from dgs_description.cell import CELL
from dgs_description.parameters import ManagedParameters, parameter
from dgs_grasp_planner.planner import SHIPPED, STAGES, PlannerSettings
from dgs_grasp_planner.propose.edge_pinch import HAND_WIDTH
from dgs_grasp_planner.propose.push import PushSettings


@dataclass(frozen=True)
class PlannerParameters(ManagedParameters):
    """Parameters of the node."""

    models_dir: str = parameter(
        "",
        "Folder of the models; empty = $DGS_MODELS_DIR, else models/ of the checkout; there that of the hand. The "
        "shape completion is always that of $DGS_MODELS_DIR or the checkout.",
    )
    model: str = parameter("dgs_net", "Name of the model: <name>.pt and <name>.json in models_dir.")
    device: str = parameter("cpu", "Where the network runs.", choices=("cpu", "cuda", "auto"))
    precision: str = parameter("auto", "Number format of the network.", choices=("auto", "fp32", "bf16"))
    torch_threads: int = parameter(1, "Threads of the network on a CPU; measure before you take more.", 1, 64)
    cloud_topic: str = parameter("/dgs/cloud", "Clouds for requests that bring none.")
    max_cloud_age: float = parameter(
        10.0, "Older clouds of the topic are stale (time since arrival) [s].", 0.1, 3600.0
    )
    skip_invalid_points: bool = parameter(False, "Drop single NaN points of a cloud instead of refusing it.")
    proposers: tuple[str, ...] = parameter(
        SHIPPED, "Who proposes grasps; what follows is the same for all.", choices=SHIPPED
    )
    without: tuple[str, ...] = parameter((), "Stages that are left out.", choices=STAGES)
    max_grasps: int = parameter(PlannerSettings.max_grasps, "For requests with max_grasps 0.", 1, 256)
    score_threshold: float = parameter(
        0.7, "Of the network's reference points, for requests with min_score 0.", 0.0, 1.0
    )
    queue_length: int = parameter(4, "Requests that may wait; more are refused as busy.", 1, 64)
    answer_timeout: float = parameter(20.0, "Every request is answered within [s].", 0.1, 600.0)

    def __post_init__(self) -> None:
        if not self.proposers:
            raise ValueError(f"no proposers; choose from {', '.join(SHIPPED)}")

    def settings(self) -> PlannerSettings:
        """Of the planner's stages."""
        return PlannerSettings(
            max_grasps=self.max_grasps,
            without=self.without,
            edge=CELL.table_edge - CELL.workspace_centre[0],
        )

    def push(self) -> PushSettings:
        """Of the pushes: their end is where the table's edge is free, half a hand farther from the robot, at y = 0."""
        (low, high), turning, y = CELL.free_edge, CELL.turning_edge, CELL.workspace_centre[1]
        low, high = (low + HAND_WIDTH / 2, high) if low + high >= 0 else (low, high - HAND_WIDTH / 2)
        return PushSettings(free=(low - y, high - y), turning=(turning[0] - y, turning[1] - y))
