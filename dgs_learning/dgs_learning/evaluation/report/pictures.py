"""Pictures of a page: an attempt with its hand, the moment of a failure, a picture file made small."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from dgs_description.camera import PinholeCamera
from dgs_description.frames import Array, apply, look_at, transform
from dgs_learning.evaluation.protocol import AttemptRecord
from dgs_learning.evaluation.scene_world import Attempt, Outcome
from dgs_learning.training.views import table_mesh
from dgs_sim_bridge.render.object_model import ObjectModel
from dgs_sim_bridge.render.pictures import (
    NO_POINTS,
    PALM_OPACITY,
    TABLE_COLOUR,
    DrawnHand,
    Item,
    Picture,
    View,
    caption,
    draw,
)

SIZE, TILE, WIDTH = 260, 280, 420
"""Edge of an attempt's picture and of a moment's, width of a scene's [px]."""
SPAN, DISTANCE = 0.34, 1.0
"""What an attempt's picture shows, and the distance that it is seen from [m]."""
ELEVATION = np.deg2rad(32.0)
GOOD, BAD, PRE_GRASP = (15, 139, 141), (200, 85, 61), (201, 204, 209)
CLOSED, TARGET, IN_THE_WAY, OTHERS = (86, 130, 190), (226, 170, 70), (150, 90, 170), (170, 174, 180)
HEIGHTS = (0.010, 0.04, 0.08)
"""Points between these heights have one colour [m]."""
LEVELS = np.array([(205, 210, 216), (127, 163, 199), (76, 127, 176), (47, 93, 140)], dtype=np.uint8)
"""Colours of points: table, then higher and higher."""


def as_jpeg(picture: Picture) -> bytes:
    """A picture (red, green, blue) as a file."""
    _, code = cv2.imencode(".jpg", cv2.cvtColor(picture, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, 82])
    return code.tobytes()


def data_uri(jpeg: bytes) -> str:
    """A file as text for a page."""
    return "data:image/jpeg;base64," + base64.b64encode(jpeg).decode()


def picture_file(path: Path) -> str:
    """A picture file, made small; empty if there is none."""
    image = cv2.imread(str(path)) if path.is_file() else None
    if image is None:
        return ""
    size = (WIDTH, round(WIDTH * image.shape[0] / image.shape[1]))
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    return data_uri(as_jpeg(cv2.cvtColor(small, cv2.COLOR_BGR2RGB)))


def draw_attempt(attempt: AttemptRecord, cloud: Array) -> str:
    """What the camera saw, (N, 3) in the frame *table* [m], the pre-grasp shape in grey, the final hand in colour."""
    hands = []
    if attempt.executed:
        place = np.add(attempt.position, attempt.motion or (0.0, 0.0, 0.0))  # where the fingers close
        T_table_tcp = transform(np.reshape(attempt.rotation, (3, 3)), place)
        azimuth = _beside(T_table_tcp)
        centre = T_table_tcp[:3, 3] - 0.02 * T_table_tcp[:3, 2]
        hands = [
            DrawnHand(T_table_tcp, np.array(attempt.pre_grasp), PRE_GRASP, opacity=0.2),
            DrawnHand(T_table_tcp, np.array(attempt.grasp), GOOD if attempt.success else BAD),
        ]
    else:
        high = cloud[cloud[:, 2] > HEIGHTS[0]]
        azimuth, centre = -1.0, high.mean(axis=0) if len(high) else np.zeros(3)
    view = _view(centre, azimuth, SPAN, SIZE)
    return data_uri(as_jpeg(draw(cloud, LEVELS[np.digitize(cloud[:, 2], HEIGHTS)], hands, view)))


def draw_failure(models: Sequence[ObjectModel], attempt: Attempt, edge: float | None = None) -> Picture:
    """The hand when it had closed and when it failed, side by side in the order of time; once if that is the same.

    Args:
        models: of the scene, by index; solid is drawn what was gripped at, and what was in the way.
        attempt: a failed one.
        edge: the table is where x is larger [m]; None = everywhere.
    """
    closed, failed = attempt.closed, attempt.failed
    assert failed is not None, "a success has no moment of failure"
    up = 1e3 * (failed.T_table_tcp[2, 3] - closed.T_table_tcp[2, 3])
    tiles = [("closed", closed, CLOSED), (f"{attempt.outcome.value}, hand {up:.0f} mm up", failed, BAD)]
    if failed is closed:
        tiles = [(attempt.outcome.value, failed, BAD)]
    solid = {attempt.object_index: TARGET}
    if attempt.outcome is Outcome.APPROACH_CONTACT and failed.moved is not None:
        tiles = [(f"in the way: {models[failed.moved].name}", failed, BAD), tiles[0]]
        solid = {failed.moved: IN_THE_WAY, **solid}
    hand = np.array([(0, 0, 0.05), (0, 0, -0.12)])
    seen = np.concatenate(
        [apply(m.T_table_tcp, hand) for m in (closed, failed)]
        + [apply(m.objects[i], models[i].vertices.astype(float)) for m in (closed, failed) for i in solid]
    )
    low, high = seen.min(axis=0), seen.max(axis=0)
    span = max(SPAN, 1.1 * float(np.linalg.norm(high - low)))
    view = _view((low + high) / 2, _beside(closed.T_table_tcp), span, TILE)
    pictures = []
    for text, moment, colour in tiles:
        items = [Item(table_mesh(edge), np.eye(4), TABLE_COLOUR)]
        for i, T in moment.objects.items():
            opacity = 1.0 if i in solid else PALM_OPACITY
            items.append(Item(models[i].mesh, T, solid.get(i, OTHERS), opacity))
        hands = [DrawnHand(moment.T_table_tcp, moment.joints, colour)]
        pictures.append(caption(draw(NO_POINTS, NO_POINTS, hands, view, items), text))
    return np.hstack(pictures)


def _beside(T_table_tcp: Array) -> float:
    """Azimuth across the pinch axis, from the side that looks down on the hand's back least [rad]."""
    return float(np.arctan2(T_table_tcp[0, 0], -T_table_tcp[1, 0])) + 0.5


def _view(centre: Array, azimuth: float, span: float, size: int) -> View:
    """From `DISTANCE` onto `centre`, showing `span` [m] in `size` [px]."""
    level = np.cos(ELEVATION)
    towards = np.array([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(ELEVATION)])
    camera = PinholeCamera.centred(size, size, size * DISTANCE / span)
    return View(camera, look_at(centre + DISTANCE * towards, centre))
