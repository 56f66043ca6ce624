"""Pictures of cloud and hands: things are where they should be, and hide one another."""

from __future__ import annotations

import numpy as np

from dgs_description.camera import PinholeCamera
from dgs_description.frames import look_at, transform
from dgs_description.hand import HAND
from dgs_sim_bridge.render.pictures import DrawnHand, View, caption, cloud_colours, draw

CAMERA = PinholeCamera(320, 240, 300.0, 300.0, 159.5, 119.5)
FROM_ABOVE = View(CAMERA, look_at((0.0, 0.0, 1.0), (0.0, 0.0, 0.0), up=(0, 1, 0)))
RED = np.array([[255, 0, 0]], dtype=np.uint8)
DRAWN = DrawnHand(transform(np.diag([1.0, -1.0, -1.0]), (0.0, 0.0, 0.3)), np.zeros(20), (0, 0, 255))


def test_a_point_is_painted_where_the_camera_sees_it():
    picture = draw(np.array([[0.1, 0.0, 0.0]]), RED, [], FROM_ABOVE)
    row, column = (int(round(axis.mean())) for axis in np.nonzero(picture[..., 1] < 128))
    assert (row, column) == (120, 190)  # 0.1 m to the right at 1 m: 30 px from the middle


def test_nearer_points_hide_farther_ones():
    points = np.array([[0.0, 0.0, 0.1], [0.0, 0.0, 0.0]])
    picture = draw(points, np.array([[0, 255, 0], [255, 0, 0]], dtype=np.uint8), [], FROM_ABOVE)
    assert picture[120, 160].tolist() == [0, 255, 0]


def test_fingertips_of_a_drawn_hand_are_blue_and_hide_what_lies_behind():
    tip = (DRAWN.T_base_tcp @ np.append(HAND.fingertips(DRAWN.joints)[2], 1.0))[:3]
    pad = tip + (0.0, 0.0, 0.01)  # the fingers point down
    behind = pad[None] - (0.1, 0.0, 0.0)
    side = View(CAMERA, look_at(pad + (0.6, 0.0, 0.0), pad))
    red, _, blue = draw(behind, RED, [DRAWN], side)[118:122, 158:162].reshape(-1, 3).mean(0)
    assert blue > 50 and red < 20


def test_points_take_the_colour_of_their_pixel():
    image = np.zeros((240, 320, 3), dtype=np.uint8)
    image[120, 190] = (1, 2, 3)
    points = np.array([[0.1015, 0.0, 0.0], [9.0, 0.0, 0.0], [0.0, 0.0, 2.0]])
    colours = cloud_colours(points, image, CAMERA, FROM_ABOVE.T_base_camera)
    assert colours.tolist() == [[1, 2, 3], [128, 128, 128], [128, 128, 128]]


def test_the_caption_leaves_the_picture_above_alone():
    picture = np.full((240, 320, 3), 200, dtype=np.uint8)
    out = caption(picture, "attempt 1")
    assert (out[:200] == 200).all() and (out[-20:] != 200).any()
    assert (picture == 200).all()
