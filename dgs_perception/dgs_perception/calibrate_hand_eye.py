"""`ros2 run dgs_perception calibrate_hand_eye samples.yaml --out my_cell.yaml`: where the camera stands."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
import typer
import yaml

from dgs_description.camera import PinholeCamera
from dgs_description.cell import QUATERNION_TOLERANCE, save_camera
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.files import atomic_write
from dgs_description.frames import Array, from_quaternion, to_quaternion
from dgs_description.yaml_text import load_yaml
from dgs_perception.board import CharucoBoard
from dgs_perception.hand_eye import MAX_RESIDUAL, MAX_SPREAD, HandEye, calibrate

HELP = """Find the pose of a camera that stands beside the robot, from poses of a board that the gripper holds.

For every sample the robot stands still. The file:

\b
    board: {columns: 7, rows: 5, square: 0.03, marker: 0.022, dictionary: DICT_4X4_50}   # only with images: ChArUco
    camera: {fx: 645.0, fy: 645.0, cx: 640.0, cy: 360.0, distortion: []}                 # only with images
    samples:
      - T_base_tool0: {position: [x, y, z], quaternion_xyzw: [x, y, z, w]}
        T_camera_board: {position: [x, y, z], quaternion_xyzw: [x, y, z, w]}             # in the optical frame
      - T_base_tool0: {position: [x, y, z], quaternion_xyzw: [x, y, z, w]}
        image: board_02.png                                                              # relative to the file

Exit code 0: written; 1: refused, the cell is as it was.
"""

_bad = partial(DgsError, ErrorCode.CALIBRATION_DATA)
app = typer.Typer(add_completion=False, rich_markup_mode=None)


def read_samples(path: Path) -> tuple[Array, Array]:
    """Poses (N, 4, 4) of `tool0` in `base_link` and board in the optical frame. Raises DgsError CALIBRATION_DATA."""
    try:
        content = load_yaml(path.read_text(encoding="utf-8"))
        samples = content["samples"]
        board = CharucoBoard(**content["board"]) if "board" in content else None
        if not isinstance(samples, list) or not samples:
            raise ValueError("`samples` must be a list")
    except (OSError, UnicodeDecodeError, yaml.YAMLError, KeyError, TypeError, ValueError) as error:
        raise _bad(f"{path} is no file of samples: {error!r}") from error
    tools, boards = [], []
    for k, sample in enumerate(samples):
        try:
            tools.append(_read_pose(sample, "T_base_tool0"))
            if "image" in sample:
                boards.append(_located(path.parent / sample["image"], board, content.get("camera")))
            else:
                boards.append(_read_pose(sample, "T_camera_board"))
        except (DgsError, AttributeError, KeyError, TypeError, ValueError) as error:
            why = error.message if isinstance(error, DgsError) else repr(error)
            raise _bad(f"sample {k} of {path}: {why}") from error
    return np.stack(tools), np.stack(boards)


def _read_pose(sample: dict[str, Any], name: str) -> Array:
    """(4, 4) pose of a mapping with `position` [m] and unit `quaternion_xyzw`. Raises DgsError CALIBRATION_DATA."""
    entry, values = sample[name], []
    for key, count in (("position", 3), ("quaternion_xyzw", 4)):
        try:
            numbers = np.array(entry.get(key), float)
        except (TypeError, ValueError):
            numbers = np.empty(0)
        if numbers.shape != (count,) or not np.isfinite(numbers).all():
            raise _bad(f"{name} has {key} {entry.get(key)!r}; it must be {count} finite numbers")
        values.append(numbers)
    position, quaternion = values
    norm = float(np.linalg.norm(quaternion))
    if abs(norm - 1.0) > QUATERNION_TOLERANCE:
        raise _bad(f"{name} has a quaternion of norm {norm:.4f}; it must be 1")
    return from_quaternion(position, quaternion / norm)


def _located(path: Path, board: CharucoBoard | None, camera: dict[str, Any] | None) -> Array:
    if board is None or camera is None:
        raise _bad("an image needs `board` and `camera` at the top of the file")
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise _bad(f"{path} is no image")
    height, width = image.shape
    pinhole = PinholeCamera(width, height, *(float(camera[key]) for key in ("fx", "fy", "cx", "cy")))
    return board.locate(np.asarray(image, np.uint8), pinhole, camera.get("distortion") or ())


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


def _write(path: Path, figures: dict[str, Any]) -> None:
    try:
        with atomic_write(path, "w") as file:
            file.write(json.dumps(figures, indent=2) + "\n")
    except OSError as error:
        raise DgsError(ErrorCode.PARAMETER_INVALID, f"{path} cannot be written: {error}") from error


@app.command(help=HELP)
def main(
    samples: Annotated[Path, typer.Argument(help="file of recorded samples")],
    out: Annotated[Path, typer.Option(help="the cell's file, for DGS_CELL; its other entries stay")],
    json_file: Annotated[
        Path | None, typer.Option("--json", dir_okay=False, help="also write the figures here")
    ] = None,
    max_residual: Annotated[float, typer.Option(help="rms of the samples [m]")] = MAX_RESIDUAL,
    max_spread: Annotated[float, typer.Option(help="leave-one-out spread [m]")] = MAX_SPREAD,
) -> None:
    """Calibrate, print, write."""
    if out == Path():
        raise typer.BadParameter("it is empty: is DGS_CELL set?", param_hint="--out")
    try:
        result = calibrate(*read_samples(samples))
        figures = summary(result)
        typer.echo("# T_base_camera: the camera's optical frame in base_link [m]")
        typer.echo(yaml.safe_dump(figures, sort_keys=False), nl=False)
        result.check(max_residual, max_spread)
        if json_file is not None:
            _write(json_file, figures)
        save_camera(out, result.T_base_camera)
    except DgsError as error:
        typer.echo(f"refused: {error.message} (code {int(error.code)})", err=True)
        raise typer.Exit(1) from error
    typer.echo(f"written to {out}")
