"""Finds a ChArUco board in an image: its pose in the camera's optical frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from dgs_description.camera import PinholeCamera
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import Array, transform

_COEFFICIENTS = (0, 4, 5, 8, 12, 14)
_LEAST_CORNERS = 8
"""A pose has 6 unknowns, 4 corners of a plane fix it; with 8 one wrong corner does not decide."""


@dataclass(frozen=True)
class CharucoBoard:
    """A ChArUco board; its frame has the origin in a corner, x along the columns, y along the rows, z into the board.

    Attributes:
        columns, rows: squares.
        square, marker: edge lengths [m].
        dictionary: name in `cv2.aruco`.
    """

    columns: int
    rows: int
    square: float
    marker: float
    dictionary: str = "DICT_4X4_50"

    def opencv(self) -> cv2.aruco.CharucoBoard:
        """OpenCV's description. Raises DgsError CALIBRATION_DATA for one that cannot be."""
        try:
            family = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))
            return cv2.aruco.CharucoBoard((self.columns, self.rows), self.square, self.marker, family)
        except (AttributeError, TypeError, SystemError, cv2.error) as error:
            wrong = f"the board {self} is not possible: {error}"
            raise DgsError(ErrorCode.CALIBRATION_DATA, wrong) from error

    def locate(
        self, image: NDArray[np.uint8], camera: PinholeCamera, distortion: Sequence[float] = ()
    ) -> Array:
        """Pose (4, 4) of the board in the camera's optical frame.

        Args:
            image: (H, W) grey, taken with the camera.
            distortion: OpenCV's coefficients; none for a rectified image.

        Raises:
            DgsError: CALIBRATION_DATA: too few corners are seen, or all in a line, or so many coefficients are none of
                OpenCV's.
        """
        board = self.opencv()
        corners, ids, _, _ = cv2.aruco.CharucoDetector(board).detectBoard(image)
        if ids is None or len(ids) < _LEAST_CORNERS:
            seen = f"{0 if ids is None else len(ids)} corners of the board are seen"
            raise DgsError(ErrorCode.CALIBRATION_DATA, f"{seen}, {_LEAST_CORNERS} are needed")
        if board.checkCharucoCornersCollinear(ids):
            raise DgsError(
                ErrorCode.CALIBRATION_DATA, "all corners that are seen lie in a line: no pose fits"
            )
        points = board.getChessboardCorners()[ids.ravel()]
        coefficients = np.asarray(distortion, float)
        if coefficients.size not in _COEFFICIENTS:
            many = f"{coefficients.size} coefficients of distortion"
            raise DgsError(ErrorCode.CALIBRATION_DATA, f"{many}; OpenCV has 0, 4, 5, 8, 12 or 14")
        found, rotation, translation = cv2.solvePnP(points, corners, camera.matrix, coefficients)
        if not found:
            raise DgsError(ErrorCode.CALIBRATION_DATA, "the corners of the board do not fit one pose")
        return transform(cv2.Rodrigues(rotation)[0], translation.ravel())
