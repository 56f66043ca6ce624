"""An answer as JSON: the frame is named, joints go by name, units are SI and radians."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from dgs_description.frames import HAND_TCP, to_quaternion, transform
from dgs_description.grasp import GraspSet
from dgs_description.joints import HAND_JOINTS
from dgs_learning.cli.offline_prediction import OfflineAnswer

Array = NDArray[np.float64]


def pose_json(T: Array) -> dict[str, list[float]]:
    """`position` [m] and `quaternion_xyzw` of a (4, 4) pose."""
    position, quaternion = to_quaternion(T)
    return {"position": _rounded(position), "quaternion_xyzw": _rounded(quaternion, 9)}


def grasps_json(grasps: GraspSet) -> list[dict[str, Any]]:
    """One entry per grasp, best first."""
    return [
        {
            "score": round(float(grasps.score[k]), 6),
            "source": str(grasps.source[k]),
            "tcp_pose": pose_json(transform(grasps.rotation[k], grasps.position[k])),
            "reference_point": _rounded(grasps.reference_point[k]),
            "offset": _rounded(grasps.offset[k]),
            "pre_grasp_joints": _joints(grasps.pre_grasp_joints[k]),
            "grasp_joints": _joints(grasps.grasp_joints[k]),
        }
        for k in range(len(grasps))
    ]


def answer_json(answer: OfflineAnswer, extra: dict[str, Any]) -> dict[str, Any]:
    """The whole answer.

    Args:
        answer: of the prediction.
        extra: entries about input and model that go before the grasps.
    """
    error, plane = answer.error, answer.plane
    table: dict[str, Any] = {"estimated": plane is not None, "pose": pose_json(answer.T_frame_table)}
    if plane is not None:
        table |= {
            "camera_height": round(plane.height, 6),
            "rms": round(plane.rms, 6),
            "share_of_cloud": round(plane.share, 4),
        }
    prediction = answer.prediction
    return {
        "error_code": 0 if error is None else int(error.code),
        "message": "" if error is None else error.message,
        "frame": answer.frame,
        "tcp_frame": HAND_TCP,
        **extra,
        "table": table,
        "camera": {"pose": pose_json(answer.T_frame_camera)},
        "points_used": prediction.points_used,
        "stage_times": {name: round(seconds, 6) for name, seconds in prediction.stage_times.items()},
        "rejected": dict(prediction.rejected),
        "grasps": grasps_json(prediction.grasps),
    }


def _joints(values: Array) -> dict[str, float]:
    return dict(zip(HAND_JOINTS, _rounded(values), strict=True))


def _rounded(values: Array, digits: int = 6) -> list[float]:
    return [round(float(value), digits) for value in values]
