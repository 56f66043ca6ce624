"""Pictures of a page as data URIs: an attempt with its hand, a picture file made small."""

from __future__ import annotations

import base64
from pathlib import Path

import cv2
import numpy as np

from dgs_description.camera import PinholeCamera
from dgs_description.frames import Array, look_at, transform
from dgs_learning.evaluation.protocol import AttemptRecord
from dgs_sim_bridge.render.pictures import DrawnHand, Picture, View, draw

SIZE, WIDTH = 260, 420
"""Edge of an attempt's picture, and width of a scene's [px]."""
SPAN, DISTANCE = 0.34, 1.0
"""What an attempt's picture shows, and the distance that it is seen from [m]."""
ELEVATION = np.deg2rad(32.0)
GOOD, BAD, PRE_GRASP = (15, 139, 141), (200, 85, 61), (201, 204, 209)
HEIGHTS = (0.010, 0.04, 0.08)
"""Points between these heights have one colour [m]."""
LEVELS = np.array([(205, 210, 216), (127, 163, 199), (76, 127, 176), (47, 93, 140)], dtype=np.uint8)
"""Colours of points: table, then higher and higher."""


def data_uri(picture: Picture) -> str:
    """A picture (red, green, blue) as text for a page."""
    _, code = cv2.imencode(".jpg", cv2.cvtColor(picture, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, 82])
    return "data:image/jpeg;base64," + base64.b64encode(code.tobytes()).decode()


def picture_file(path: Path) -> str:
    """A picture file, made small; empty if there is none."""
    image = cv2.imread(str(path)) if path.is_file() else None
    if image is None:
        return ""
    size = (WIDTH, round(WIDTH * image.shape[0] / image.shape[1]))
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    return data_uri(cv2.cvtColor(small, cv2.COLOR_BGR2RGB))


def draw_attempt(attempt: AttemptRecord, cloud: Array) -> str:
    """What the camera saw, (N, 3) in the frame *table* [m], the pre-grasp shape in grey, the final hand in colour."""
    hands = []
    if attempt.executed:
        T_table_tcp = transform(np.reshape(attempt.rotation, (3, 3)), attempt.position)
        # Across the pinch axis, from the side that looks down on the hand's back least.
        azimuth = np.arctan2(T_table_tcp[0, 0], -T_table_tcp[1, 0]) + 0.5
        centre = T_table_tcp[:3, 3] - 0.02 * T_table_tcp[:3, 2]
        hands = [
            DrawnHand(T_table_tcp, np.array(attempt.pre_grasp), PRE_GRASP, opacity=0.2),
            DrawnHand(T_table_tcp, np.array(attempt.grasp), GOOD if attempt.success else BAD),
        ]
    else:
        high = cloud[cloud[:, 2] > HEIGHTS[0]]
        azimuth, centre = -1.0, high.mean(axis=0) if len(high) else np.zeros(3)
    level = np.cos(ELEVATION)
    towards = np.array([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(ELEVATION)])
    focal = SIZE * DISTANCE / SPAN
    middle = (SIZE - 1) / 2
    camera = PinholeCamera(SIZE, SIZE, focal, focal, middle, middle)
    view = View(camera, look_at(centre + DISTANCE * towards, centre))
    return data_uri(draw(cloud, LEVELS[np.digitize(cloud[:, 2], HEIGHTS)], hands, view))
