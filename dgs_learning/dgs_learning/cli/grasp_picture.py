"""The picture of an answer: the cloud with the best hands in it."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from dgs_description.frames import CELL, apply, inverse, transform
from dgs_grasp_planner.network.decode import non_maximum_suppression
from dgs_learning.cli.offline_prediction import HEIGHT, OfflineAnswer
from dgs_sim_bridge.render.pictures import DrawnHand, Picture, View, caption, draw, palette

MAX_HANDS = 5
MIN_DISTANCE = 0.10
"""Hands in the picture are at least so far apart, so that they can be told apart [m]."""


def draw_answer(answer: OfflineAnswer, colours: NDArray[np.uint8] | None) -> Picture:
    """Picture (720, 1280, 3) uint8, red green blue.

    Args:
        answer: of the prediction.
        colours: (N, 3) of the answer's points, or None: coloured by height.
    """
    # The virtual camera looks at the cell's workspace, so the table is put there.
    T_view_frame = CELL.T_base_table @ inverse(answer.T_frame_table)
    points = apply(T_view_frame, answer.points.astype(np.float64))
    if colours is None:
        colours = _by_height(points[:, 2] - CELL.table_height)
    grasps = answer.prediction.grasps.moved(T_view_frame)
    chosen = non_maximum_suppression(grasps.position, grasps.score, MIN_DISTANCE, MAX_HANDS)
    hands = [
        DrawnHand(transform(grasps.rotation[k], grasps.position[k]), grasps.grasp_joints[k], colour)
        for k, colour in zip(chosen, palette(len(chosen)), strict=True)
    ]
    note = f"{len(grasps)} grasps, drawn: the best {len(hands)} that are {MIN_DISTANCE * 100:.0f} cm apart"
    if answer.error is not None:
        note = answer.error.message
    return caption(draw(points, colours, hands, View.oblique()), note)


def save_picture(path: str, picture: Picture) -> None:
    """Write a picture; the suffix says the format. Raises OSError."""
    try:
        written = cv2.imwrite(path, cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))
    except cv2.error as error:
        raise OSError(f"{path}: {error}") from error
    if not written:
        raise OSError(f"{path} cannot be written")


def _by_height(height: NDArray) -> NDArray[np.uint8]:
    """Table grey, objects from blue to yellow."""
    share = np.clip(height / (0.6 * HEIGHT), 0.0, 1.0)
    shades = (255 * share).astype(np.uint8)[:, None]
    colours = cv2.applyColorMap(shades, cv2.COLORMAP_VIRIDIS)[:, 0, ::-1].copy()
    colours[height < 0.008] = (188, 188, 192)
    return colours
