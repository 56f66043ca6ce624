"""Hand-eye calibration of a camera that stands beside the robot (eye-to-hand), from poses of a board in the gripper.

The board is fixed to the tool: T_base_tool(i) T_tool_board = T_base_camera T_camera_board(i) for every sample i, with
two unknown constant transforms. The start comes from relative motions as of Park and Martin (IEEE T-RA 10(5), 1994):
rotation vectors of tool and board motions are aligned, then the translation follows from linear least squares.
Levenberg-Marquardt over both unknowns fits all samples. (OpenCV 5 has no Python function for hand-eye calibration.)
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from itertools import combinations

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import Array, inverse, transform

_bad = partial(DgsError, ErrorCode.CALIBRATION_DATA)
LEVER = 0.3
"""An angle counts as the way it moves a point so far away, where angles and lengths are weighed together [m]."""
LEAST_SAMPLES = 6
LEAST_SECOND_AXIS = float(np.deg2rad(8.0))
"""Rms rotation of the tool about the second of its main axes of rotation [rad]."""
MAX_RESIDUAL, MAX_RESIDUAL_ANGLE = 0.005, float(np.deg2rad(0.8))
"""Rms deviation of the samples [m], [rad]."""
MAX_SPREAD = 0.005
"""Change of the camera's position when one sample is left out [m]."""


@dataclass(frozen=True)
class HandEye:
    """Result of a calibration.

    Attributes:
        T_base_camera: (4, 4) pose of the camera's optical frame in `base_link`.
        residuals: (N,) distance of every sample's board from where the result puts it [m].
        residual_angles: (N,) the same as an angle [rad].
        spread: largest change of the camera's position when one sample is left out [m].
        spread_angle: the same of its orientation [rad].
        second_axis: rms rotation of the tool about the second of its main axes [rad].
    """

    T_base_camera: Array
    residuals: Array
    residual_angles: Array
    spread: float
    spread_angle: float
    second_axis: float

    def check(self, max_residual: float = MAX_RESIDUAL, max_spread: float = MAX_SPREAD) -> None:
        """Raise DgsError CALIBRATION_DATA, with the worst sample, if the result may not be used."""
        rms, angle = (float(np.sqrt(np.mean(r**2))) for r in (self.residuals, self.residual_angles))
        worst = int(np.argmax(self.residuals + LEVER * self.residual_angles))
        if not (rms <= max_residual and angle <= MAX_RESIDUAL_ANGLE):
            raise _bad(
                f"the samples do not agree: rms {1e3 * rms:.1f} mm and {np.rad2deg(angle):.2f} deg, allowed are "
                f"{1e3 * max_residual:.1f} mm and {np.rad2deg(MAX_RESIDUAL_ANGLE):.2f} deg; the worst is sample "
                f"{worst} ({1e3 * self.residuals[worst]:.1f} mm, {np.rad2deg(self.residual_angles[worst]):.2f} deg). "
                "Was the board loose, are the poses T_base_tool0 and T_camera_board, and in metres?"
            )
        if not self.spread <= max_spread:
            raise _bad(
                f"leaving one sample out moves the camera by {1e3 * self.spread:.1f} mm, allowed are "
                f"{1e3 * max_spread:.1f} mm: take more samples, turned farther"
            )


def calibrate(T_base_tool: Array, T_camera_board: Array) -> HandEye:
    """Find the camera; `HandEye.check` judges the result.

    Args:
        T_base_tool: (N, 4, 4) measured poses of the tool.
        T_camera_board: (N, 4, 4) poses of the board in the camera's optical frame, in the same order.

    Raises:
        DgsError: CALIBRATION_DATA: different or too small numbers, values that are not finite, or a tool that was
            turned about one axis only, which leaves the camera's place along that axis open.
    """
    tools, boards = np.asarray(T_base_tool, float), np.asarray(T_camera_board, float)
    if tools.shape != boards.shape:
        raise _bad(f"there are {len(tools)} poses of the tool and {len(boards)} of the board")
    if len(tools) < LEAST_SAMPLES:
        raise _bad(f"{len(tools)} samples are too few, at least {LEAST_SAMPLES} are needed")
    if not (np.isfinite(tools).all() and np.isfinite(boards).all()):
        raise _bad("a pose holds numbers that are not finite")
    second_axis = _second_axis(tools)
    if second_axis < LEAST_SECOND_AXIS:
        raise _bad(
            f"the tool was turned about one axis only ({np.rad2deg(second_axis):.1f} deg rms about the second one, at "
            f"least {np.rad2deg(LEAST_SECOND_AXIS):.0f} are needed): tilt the board in different directions"
        )
    camera, board = _solve(tools, boards)
    deviation = inverse(camera @ boards) @ tools @ board
    every = np.arange(len(tools))
    others = [_solve(tools[every != k], boards[every != k])[0] for k in every]
    changes = inverse(camera) @ np.stack(others)
    return HandEye(
        T_base_camera=camera,
        residuals=np.linalg.norm(deviation[:, :3, 3], axis=1),
        residual_angles=_angles(deviation),
        spread=float(np.linalg.norm(changes[:, :3, 3], axis=1).max()),
        spread_angle=float(_angles(changes).max()),
        second_axis=second_axis,
    )


def _solve(tools: Array, boards: Array) -> tuple[Array, Array]:
    """T_base_camera and T_tool_board of the least squares."""
    start = _closed_form(tools, boards)
    first = Rotation.from_matrix((inverse(tools) @ start @ boards)[:, :3, :3]).mean().as_matrix()
    board = transform(first, (inverse(tools) @ start @ boards)[:, :3, 3].mean(0))

    def unpack(x: Array) -> tuple[Array, Array]:
        return start @ _small(x[:6]), board @ _small(x[6:])

    def deviation(x: Array) -> Array:
        camera, held = unpack(x)
        off = inverse(camera @ boards) @ tools @ held
        angles = Rotation.from_matrix(off[:, :3, :3]).as_rotvec()
        return np.concatenate([off[:, :3, 3].ravel(), LEVER * angles.ravel()])

    return unpack(least_squares(deviation, np.zeros(12), method="lm").x)


def _closed_form(tools: Array, boards: Array) -> Array:
    """T_base_camera from the relative motions A X = X B of all pairs (Park and Martin, 1994)."""
    first, second = np.array(list(combinations(range(len(tools)), 2))).T
    A, B = tools[second] @ inverse(tools[first]), boards[second] @ inverse(boards[first])
    alpha, beta = (Rotation.from_matrix(motion[:, :3, :3]).as_rotvec() for motion in (A, B))
    rotation = Rotation.align_vectors(alpha, beta)[0].as_matrix()
    left = (A[:, :3, :3] - np.eye(3)).reshape(-1, 3)
    right = (B[:, :3, 3] @ rotation.T - A[:, :3, 3]).ravel()
    return transform(rotation, np.linalg.lstsq(left, right, rcond=None)[0])


def _second_axis(tools: Array) -> float:
    """Rms rotation of the tool about the second of its main axes, relative to its mean orientation [rad]."""
    rotations = Rotation.from_matrix(tools[:, :3, :3])
    turned = (rotations * rotations.mean().inv()).as_rotvec()
    return float(np.linalg.svd(turned, compute_uv=False)[1] / np.sqrt(len(turned)))


def _small(x: Array) -> Array:
    return transform(Rotation.from_rotvec(x[3:]).as_matrix(), x[:3])


def _angles(transforms: Array) -> Array:
    return np.asarray(Rotation.from_matrix(transforms[:, :3, :3]).magnitude())
