"""A rendered ChArUco board is found where it is."""

from __future__ import annotations

import re

import cv2
import numpy as np
import pytest
import yaml

from dgs_description.camera import PinholeCamera
from dgs_description.errors import ErrorCode
from dgs_description.frames import from_rpy, inverse
from dgs_perception.board import CharucoBoard
from dgs_perception.calibrate_hand_eye import HELP
from tests.support.environment import REPO_ROOT
from tests.support.refused import refused

BOARD = CharucoBoard(7, 5, square=0.03, marker=0.022)
CAMERA = PinholeCamera(848, 480, 900.0, 900.0, 424.0, 240.0)
PIXELS = 4000
"""Of the drawn board per metre."""
FINE = 4


def picture(
    T_camera_board: np.ndarray, board: CharucoBoard = BOARD, camera: PinholeCamera = CAMERA
) -> np.ndarray:
    """What a pinhole camera sees of the board, grey around it."""
    size = [int(count * board.square * PIXELS) for count in (board.columns, board.rows)]
    drawn = board.opencv().generateImage(size)
    # Pixel (u, v) of the drawing shows the point (u + 0.5, v + 0.5) / PIXELS of the board's plane.
    to_board = np.array([[1 / PIXELS, 0, 0.5 / PIXELS], [0, 1 / PIXELS, 0.5 / PIXELS], [0, 0, 1]])
    # Every pixel is the mean of FINE x FINE, the middle of which is the pixel's.
    to_fine = np.array([[FINE, 0, (FINE - 1) / 2], [0, FINE, (FINE - 1) / 2], [0, 0, 1]])
    to_image = to_fine @ camera.matrix @ T_camera_board[:3, [0, 1, 3]] @ to_board
    fine = (camera.width * FINE, camera.height * FINE)
    seen = cv2.warpPerspective(drawn, to_image, fine, flags=cv2.INTER_AREA, borderValue=128)
    return cv2.resize(seen, (camera.width, camera.height), interpolation=cv2.INTER_AREA)


@pytest.mark.parametrize("distortion", [(), (-0.3, 0.1, 0.0, 0.0)])
@pytest.mark.parametrize("rpy", [(0.0, 0.0, 0.0), (0.5, 0.0, 0.3), (0.1, -0.6, -1.0)])
def test_board_is_found_to_a_millimetre(
    rpy: tuple[float, float, float], distortion: tuple[float, ...]
) -> None:
    truth = from_rpy((-0.05, -0.04, 0.5), rpy)
    seen = picture(truth)
    if distortion:
        pixels = np.indices(seen.shape, np.float32)[::-1].reshape(2, -1).T
        straight = cv2.undistortPoints(pixels, CAMERA.matrix, np.array(distortion), P=CAMERA.matrix)
        seen = cv2.remap(seen, straight.reshape(*seen.shape, 2), None, cv2.INTER_LINEAR)
    found = BOARD.locate(seen, CAMERA, distortion)
    off = inverse(truth) @ found
    assert np.linalg.norm(off[:3, 3]) < 0.001
    assert np.rad2deg(np.arccos(np.clip((np.trace(off[:3, :3]) - 1) / 2, -1, 1))) < 0.4


@pytest.mark.parametrize("tilt", [0.0, 0.35, 0.7])
def test_the_board_of_the_documentation_is_found_by_its_camera_from_0_85_m(tilt: float) -> None:
    text = (REPO_ROOT / "docs/real_robot.md").read_text()
    lines = [
        line for key in ("board", "camera") for line in re.findall(rf"^{key}: {{.*}}", text, re.MULTILINE)
    ]
    assert all(line in HELP for line in lines)
    given = yaml.safe_load("\n".join(lines))
    board = CharucoBoard(**given["board"])
    fx, fy, cx, cy = (given["camera"][key] for key in ("fx", "fy", "cx", "cy"))
    camera = PinholeCamera(round(2 * cx), round(2 * cy), fx, fy, cx, cy)
    truth = from_rpy((0.0, 0.0, 0.85), (0.6 * tilt, 0.8 * tilt, 0.0))
    truth[:3, 3] -= truth[:3, :3] @ (0.105, 0.075, 0.0)  # its middle is before the camera
    found = board.locate(picture(truth, board, camera), camera)
    assert np.linalg.norm(found[:3, 3] - truth[:3, 3]) < 0.003


def test_corners_in_a_line_give_no_pose() -> None:
    board = CharucoBoard(12, 3, square=0.03, marker=0.022)
    drawn = board.opencv().generateImage((800, 200))
    drawn[160:] = 255  # the second row of corners is hidden
    image = cv2.copyMakeBorder(drawn, 140, 140, 24, 24, cv2.BORDER_CONSTANT, value=255)
    with refused(ErrorCode.CALIBRATION_DATA, "in a line"):
        board.locate(image, CAMERA)


def test_image_without_a_board_and_impossible_boards_are_refused() -> None:
    empty = np.full((480, 848), 128, np.uint8)
    for action in (
        lambda: BOARD.locate(empty, CAMERA),
        lambda: BOARD.locate(picture(from_rpy((-0.05, -0.04, 0.5), (0, 0, 0))), CAMERA, [0.1, 0.0, 0.0]),
        lambda: CharucoBoard(7, 5, 0.03, 0.04).opencv(),
        lambda: CharucoBoard(7, 5, 0.03, 0.02, "DICT_OF_MINE").opencv(),
    ):
        with refused(ErrorCode.CALIBRATION_DATA):
            action()
