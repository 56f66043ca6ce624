"""`ros2 run dgs_perception calibrate_hand_eye samples.yaml --out extrinsics.yaml`: where the camera stands.

The board is held by the gripper; for every sample the robot stands still. The file:

    board: {columns: 7, rows: 5, square: 0.03, marker: 0.022, dictionary: DICT_4X4_50}   # only with images: ChArUco
    camera: {fx: 447.0, fy: 447.0, cx: 424.0, cy: 240.0, distortion: []}                 # only with images
    samples:
      - T_base_tool0: {position: [x, y, z], quaternion_xyzw: [x, y, z, w]}
        T_camera_board: {position: [x, y, z], quaternion_xyzw: [x, y, z, w]}             # in the optical frame
      - T_base_tool0: {position: [x, y, z], quaternion_xyzw: [x, y, z, w]}
        image: board_02.png                                                              # relative to the file

Exit code 0: written; 1: the data were refused, nothing is written.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn

import cv2
import numpy as np
import yaml

from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import Array, from_quaternion, to_quaternion
from dgs_perception.board import Camera, CharucoBoard
from dgs_perception.extrinsics import QUATERNION_TOLERANCE, save_extrinsics
from dgs_perception.hand_eye import HandEye, HandEyeLimits, calibrate


def read_samples(path: Path) -> tuple[Array, Array]:
    """Poses (N, 4, 4) of `tool0` in `base_link` and of the board in the camera's optical frame.

    Raises:
        DgsError: CALIBRATION_DATA, with the number of the sample: what cannot be read or is missing.
    """
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
        samples = content["samples"]
        board = CharucoBoard(**content["board"]) if "board" in content else None
        camera = Camera(**content["camera"]) if "camera" in content else None
        if not isinstance(samples, list) or not samples:
            raise ValueError("`samples` must be a list")
    except (OSError, UnicodeDecodeError, yaml.YAMLError, KeyError, TypeError, ValueError) as error:
        raise DgsError(ErrorCode.CALIBRATION_DATA, f"{path} is no file of samples: {error!r}") from error
    tools, boards = [], []
    for k, sample in enumerate(samples):
        try:
            tools.append(_pose(sample["T_base_tool0"]))
            if "image" in sample:
                boards.append(_located(path.parent / sample["image"], board, camera))
            else:
                boards.append(_pose(sample["T_camera_board"]))
        except (KeyError, TypeError, ValueError) as error:
            raise DgsError(ErrorCode.CALIBRATION_DATA, f"sample {k} of {path}: {error!r}") from error
        except DgsError as error:
            raise DgsError(error.code, f"sample {k} of {path}: {error.message}") from error
    return np.stack(tools), np.stack(boards)


def _pose(entry: dict[str, Any]) -> Array:
    position, quaternion = np.array(entry["position"], float), np.array(entry["quaternion_xyzw"], float)
    if position.shape != (3,) or quaternion.shape != (4,):
        raise ValueError("a pose is a position of 3 and a quaternion_xyzw of 4 numbers")
    norm = float(np.linalg.norm(quaternion))
    if not abs(norm - 1.0) < QUATERNION_TOLERANCE:
        raise ValueError(f"the quaternion has the norm {norm:.4f}, it must be 1")
    return from_quaternion(position, quaternion / norm)


def _located(path: Path, board: CharucoBoard | None, camera: Camera | None) -> Array:
    if board is None or camera is None:
        raise ValueError("an image needs `board` and `camera` at the top of the file")
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise ValueError(f"{path} is no image")
    return board.locate(np.asarray(image, np.uint8), camera)[0]


def summary(result: HandEye) -> dict[str, Any]:
    """Figures of a result, in metres and degrees."""
    position, quaternion = to_quaternion(result.T_base_camera)
    return {
        "samples": len(result.residuals),
        "position": [round(float(v), 6) for v in position],
        "quaternion_xyzw": [round(float(v), 9) for v in quaternion],
        "residual_rms_m": float(np.sqrt(np.mean(result.residuals**2))),
        "residual_max_m": float(result.residuals.max()),
        "residual_rms_deg": float(np.rad2deg(np.sqrt(np.mean(result.residual_angles**2)))),
        "leave_one_out_m": result.spread,
        "leave_one_out_deg": float(np.rad2deg(result.spread_angle)),
        "second_axis_deg": float(np.rad2deg(result.second_axis)),
    }


def main(args: Sequence[str] | None = None) -> NoReturn:
    """Calibrate, print, write, end with the exit code."""
    default = HandEyeLimits()
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter, prog="calibrate_hand_eye"
    )
    parser.add_argument("samples", type=Path, help="file of recorded samples")
    parser.add_argument(
        "--out", type=Path, required=True, help="extrinsics file for the parameter extrinsics_file"
    )
    parser.add_argument("--json", type=Path, help="also write the figures here")
    parser.add_argument("--max-residual", type=float, default=default.residual, help="rms of the samples [m]")
    parser.add_argument("--max-spread", type=float, default=default.spread, help="leave-one-out spread [m]")
    given = parser.parse_args(args)
    limits = HandEyeLimits(residual=given.max_residual, spread=given.max_spread)
    try:
        result = calibrate(*read_samples(given.samples), limits)
        figures = summary(result)
        print(yaml.safe_dump(figures, sort_keys=False), end="")
        result.check(limits)
    except DgsError as error:
        print(f"refused: {error.message} (code {int(error.code)})", file=sys.stderr)
        sys.exit(1)
    save_extrinsics(given.out, result.T_base_camera)
    if given.json is not None:
        given.json.write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")
    print(f"written to {given.out}")
    sys.exit(0)
