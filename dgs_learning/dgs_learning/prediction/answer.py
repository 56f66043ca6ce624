"""An answer as JSON (the frame is named, joints go by name, SI units and radians) and as a picture."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from dgs_description.cell import CELL
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import HAND_TCP, OBJECT_HEIGHT, Array, apply, inverse, to_quaternion
from dgs_description.grasp import GraspSet
from dgs_description.hand import HAND
from dgs_description.words import plural
from dgs_learning.prediction.offline import HEIGHT, OfflineAnswer
from dgs_sim_bridge.render.pictures import DrawnHand, Picture, View, caption, draw, palette

MAX_HANDS = 5
MIN_DISTANCE = 0.10
"""Hands in the picture are at least so far apart, so that they can be told apart [m]."""
TABLE_COLOUR = (188, 188, 192)


def write_answer(
    answer: OfflineAnswer,
    extra: dict[str, Any],
    colours: NDArray[np.uint8] | None,
    json_file: Path | None,
    picture: Path | None,
) -> None:
    """Write what is wanted of an answer.

    Args:
        extra: entries about input and model that go before the grasps.
        colours: (N, 3) of the answer's points, or None: coloured by height.
        json_file, picture: where to, or None; the picture's suffix says the format.

    Raises:
        DgsError: REQUEST_INVALID, a file cannot be written.
    """
    try:
        for file in (json_file, picture):
            if file is not None:
                file.parent.mkdir(parents=True, exist_ok=True)
        if json_file is not None:
            json_file.write_text(json.dumps(answer_json(answer, extra), indent=1) + "\n", encoding="utf-8")
        if picture is not None:
            image = cv2.cvtColor(draw_answer(answer, colours), cv2.COLOR_RGB2BGR)
            if not cv2.imwrite(str(picture), image):
                raise OSError(f"{picture} cannot be written")
    except (OSError, cv2.error) as error:
        raise DgsError(ErrorCode.REQUEST_INVALID, f"the result cannot be written: {error}") from error


def answer_json(answer: OfflineAnswer, extra: dict[str, Any]) -> dict[str, Any]:
    """The whole answer; `extra` goes before the grasps."""
    error, plane = answer.error, answer.plane
    table: dict[str, Any] = {"estimated": plane is not None, "pose": pose_json(answer.T_frame_table)}
    if plane is not None:
        height, rms, share = round(plane.height, 6), round(plane.rms, 6), round(plane.share, 4)
        table |= {"camera_height": height, "rms": rms, "share_of_cloud": share}
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
        "grasps": [grasp_json(prediction.grasps[k]) for k in range(len(prediction.grasps))],
    }


def grasp_json(grasp: GraspSet) -> dict[str, Any]:
    """One grasp."""
    shapes = {"pre_grasp_joints": grasp.pre_grasp_joints, "grasp_joints": grasp.grasp_joints}
    return {
        "score": round(float(grasp.score), 6),
        "source": str(grasp.source),
        "tcp_pose": pose_json(grasp.pose),
        "reference_point": _rounded(grasp.reference_point),
        "offset": _rounded(grasp.offset),
        **{name: dict(zip(HAND.joints, _rounded(values), strict=True)) for name, values in shapes.items()},
    }


def pose_json(T: Array) -> dict[str, list[float]]:
    """`position` [m] and `quaternion_xyzw` of a (4, 4) pose."""
    position, quaternion = to_quaternion(T)
    return {"position": _rounded(position), "quaternion_xyzw": _rounded(quaternion, 9)}


def _rounded(values: Array, digits: int = 6) -> list[float]:
    return np.round(values, digits).tolist()


def draw_answer(answer: OfflineAnswer, colours: NDArray[np.uint8] | None) -> Picture:
    """The cloud with the best hands in it, (720, 1280, 3) uint8, red green blue."""
    # The virtual camera looks at the cell's workspace, so the table is put there.
    T_view_frame = CELL.T_base_table @ inverse(answer.T_frame_table)
    points = apply(T_view_frame, answer.points.astype(np.float64))
    if colours is None:
        colours = _by_height(points[:, 2] - CELL.table_height)
    grasps = answer.prediction.grasps.moved(T_view_frame)
    chosen = grasps.apart(MIN_DISTANCE, MAX_HANDS)
    shown = zip(chosen.pose, chosen.grasp_joints, palette(len(chosen)), strict=True)
    hands = [DrawnHand(*hand) for hand in shown]
    note = f"{plural(len(grasps), 'grasp')}, drawn: the best {len(hands)} that are {MIN_DISTANCE * 100:.0f} cm apart"
    if answer.error is not None:
        note = answer.error.message
    return caption(draw(points, colours, hands, View.oblique()), note)


def _by_height(height: Array) -> NDArray[np.uint8]:
    """Table grey, objects from blue to yellow."""
    shades = (255 * np.clip(height / (0.6 * HEIGHT), 0.0, 1.0)).astype(np.uint8)[:, None]
    colours = cv2.applyColorMap(shades, cv2.COLORMAP_VIRIDIS)[:, 0, ::-1].copy()
    colours[height < OBJECT_HEIGHT] = TABLE_COLOUR
    return colours
