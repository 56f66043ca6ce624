"""Parameters of the grasp planner node, and the settings of the stages that they make up."""

from __future__ import annotations

from dataclasses import dataclass

from dgs_description.frames import CAMERA_OPTICAL, CELL, to_quaternion
from dgs_grasp_planner.checks import CheckConfig
from dgs_grasp_planner.contact.fit import RefineConfig
from dgs_grasp_planner.network.decode import DecodeConfig
from dgs_grasp_planner.propose.level_pinch import LevelPinchConfig
from dgs_ros.parameters import parameter

_POSITION, _QUATERNION = (tuple(part.tolist()) for part in to_quaternion(CELL.T_base_camera_optical))


@dataclass(frozen=True)
class PlannerParameters:
    """Parameters of the node."""

    models_dir: str = parameter(
        "", "Folder of the models; empty = $DGS_MODELS_DIR, else models/ of the checkout."
    )
    model: str = parameter("dgs_net", "Name of the model: <name>.pt and <name>.json in models_dir.")
    device: str = parameter("cpu", "Where the network runs.", choices=("cpu", "cuda", "auto"))
    precision: str = parameter("auto", "Number format of the network.", choices=("auto", "fp32", "bf16"))
    torch_threads: int = parameter(
        1, "Threads of the network on a CPU; measure before you take more.", minimum=1, maximum=64
    )
    cloud_topic: str = parameter("/dgs/cloud", "Clouds for requests that bring none.")
    max_cloud_age: float = parameter(
        10.0, "Older clouds of the topic are stale (time since arrival) [s].", minimum=0.1, maximum=3600.0
    )
    camera_frame: str = parameter(CAMERA_OPTICAL, "Frame of the camera, for the view rays.")
    camera_position: tuple[float, float, float] = parameter(
        _POSITION,
        "Of camera_frame in base_link until /tf_static says otherwise [m].",
        minimum=-10.0,
        maximum=10.0,
    )
    camera_quaternion: tuple[float, float, float, float] = parameter(
        _QUATERNION, "Orientation xyzw to camera_position.", minimum=-1.0, maximum=1.0
    )
    skip_invalid_points: bool = parameter(False, "Drop single NaN points of a cloud instead of refusing it.")
    workspace_margin: float = parameter(
        0.03, "Points farther outside of the workspace are ignored [m].", minimum=0.0, maximum=1.0
    )
    max_grasps: int = parameter(32, "For requests with max_grasps 0.", minimum=1, maximum=256)
    score_threshold: float = parameter(
        0.7, "Of reference points, for requests with min_score 0.", minimum=0.0, maximum=1.0
    )
    fallback_threshold: float = parameter(
        0.3, "The same, where none of the network's passes the checks; 1 = off.", minimum=0.0, maximum=1.0
    )
    nms_radius: float = parameter(0.025, "Between reference points [m].", minimum=0.001, maximum=0.2)
    reference_points: int = parameter(32, "Most reference points per cloud.", minimum=1, maximum=256)
    hypotheses: int = parameter(3, "Rotations tried per reference point.", minimum=1, maximum=16)
    refine_move: bool = parameter(True, "Correct the place of the hand by a centimetre at most.")
    refine_close: bool = parameter(True, "Close the fingers onto the cloud; else the network's joints.")
    refine_rank: bool = parameter(True, "Multiply the network's score by the quality of the contacts.")
    refine_complete: bool = parameter(True, "Guess the hidden sides of objects from symmetry.")
    refine_candidates: int = parameter(
        48, "So many of the best are refined, the rest is dropped.", minimum=1, maximum=768
    )
    refine_standoff: float = parameter(
        0.001, "Distance to the cloud that the final joints keep [m].", minimum=0.0, maximum=0.01
    )
    refine_proposals: int = parameter(
        8, "Level pinches are proposed at so many places of long things that lie flat.", minimum=0, maximum=64
    )
    approach: float = parameter(
        0.10, "Straight way to the grasp that must be free [m].", minimum=0.0, maximum=0.3
    )
    table_clearance: float = parameter(
        0.0, "Height of the pre-grasp shape above the table [m].", minimum=-0.02, maximum=0.1
    )
    closed_clearance: float = parameter(
        0.0, "Height of the final shape above the table [m].", minimum=-0.02, maximum=0.1
    )
    table_lift: float = parameter(
        0.012, "Grasps too low by no more than this are lifted [m].", minimum=0.0, maximum=0.05
    )
    cloud_depth: float = parameter(
        0.005, "Cloud points count when so deep inside the hand [m].", minimum=0.0, maximum=0.05
    )
    cloud_points: int = parameter(3, "So many such points are forgiven.", minimum=0, maximum=1000)
    queue_length: int = parameter(
        4, "Requests that may wait; more are refused as busy.", minimum=1, maximum=64
    )
    answer_timeout: float = parameter(
        20.0, "Every request is answered within [s].", minimum=0.1, maximum=600.0
    )

    def decode(self) -> DecodeConfig:
        """How candidates are chosen."""
        return DecodeConfig(
            score_threshold=self.score_threshold,
            fallback_threshold=self.fallback_threshold,
            nms_radius=self.nms_radius,
            max_points=self.reference_points,
            hypotheses=self.hypotheses,
        )

    def refine(self) -> RefineConfig:
        """How candidates are fitted to the cloud."""
        return RefineConfig(
            move=self.refine_move,
            close=self.refine_close,
            rank=self.refine_rank,
            complete=self.refine_complete,
            candidates=self.refine_candidates,
            standoff=self.refine_standoff,
            level_pinch=LevelPinchConfig(proposals=self.refine_proposals),
        )

    def checks(self) -> CheckConfig:
        """What rejects a candidate."""
        return CheckConfig(
            approach=self.approach,
            table_clearance=self.table_clearance,
            closed_clearance=self.closed_clearance,
            table_lift=self.table_lift,
            cloud_depth=self.cloud_depth,
            cloud_points=self.cloud_points,
        )
