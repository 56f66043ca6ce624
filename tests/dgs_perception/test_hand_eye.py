"""Hand-eye calibration from synthetic poses, and its command."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from dgs_description.cell import CELL, load_cell
from dgs_description.errors import ErrorCode
from dgs_description.frames import from_rpy, inverse, to_quaternion, transform
from dgs_perception.calibrate_hand_eye import app, read_samples
from dgs_perception.hand_eye import calibrate
from tests.dgs_perception.test_board import BOARD, CAMERA, picture
from tests.support.refused import refused

T_BASE_CAMERA = CELL.T_base_camera_optical
T_TOOL_BOARD = from_rpy((0.02, -0.03, 0.12), (0.1, 2.9, 0.4))


def samples(
    count: int = 15, seed: int = 0, tilt: float = 0.5, position_noise: float = 0.0, angle_noise: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Poses of tool and board; the noise [m, rad] is in the board's pose."""
    rng = np.random.default_rng(seed)
    places = rng.uniform((0.2, -0.25, 0.0), (0.4, 0.25, 0.25), (count, 3))
    turns = (np.pi, 0, 0) + rng.normal(0, tilt, (count, 3))
    tools = np.stack([from_rpy(*pose) for pose in zip(places, turns, strict=True)])
    off = Rotation.from_rotvec(rng.normal(0, angle_noise, (count, 3))).as_matrix()
    shifts = rng.normal(0, position_noise, (count, 3))
    noise = np.stack([transform(*pose) for pose in zip(off, shifts, strict=True)])
    return tools, inverse(T_BASE_CAMERA) @ tools @ T_TOOL_BOARD @ noise


def error(result: np.ndarray) -> tuple[float, float]:
    off = inverse(T_BASE_CAMERA) @ result
    return float(np.linalg.norm(off[:3, 3])), float(Rotation.from_matrix(off[:3, :3]).magnitude())


def test_exact_poses_give_the_exact_camera() -> None:
    result = calibrate(*samples())
    assert error(result.T_base_camera) == pytest.approx((0, 0), abs=1e-8)
    assert result.residuals.max() < 1e-8 and result.spread < 1e-8


@pytest.mark.parametrize("seed", range(5))
def test_noise_of_a_millimetre_is_averaged(seed: int) -> None:
    result = calibrate(*samples(20, seed, position_noise=0.001, angle_noise=np.deg2rad(0.15)))
    result.check()
    position, angle = error(result.T_base_camera)
    assert position < 0.003 and angle < np.deg2rad(0.2)
    # The residuals tell the noise: three axes of a millimetre, and what the angles add at the tool.
    assert 0.001 < np.sqrt(np.mean(result.residuals**2)) < 0.003
    assert 0 < result.spread < 0.003


def test_data_that_leave_the_camera_open_are_refused() -> None:
    tools, boards = samples()
    turned = np.stack([tools[0] @ from_rpy((0.02 * k, 0, 0), (0, 0, 0.3 * k)) for k in range(10)])
    about_one_axis = inverse(T_BASE_CAMERA) @ turned @ T_TOOL_BOARD
    lost = boards.copy()
    lost[3, 0, 3] = np.nan
    for words, tool, board in (
        ("about one axis only", turned, about_one_axis),
        ("too few", tools[:5], boards[:5]),
        ("15 poses of the tool and 14 of the board", tools, boards[:-1]),
        ("not finite", tools, lost),
    ):
        with refused(ErrorCode.CALIBRATION_DATA, words):
            calibrate(tool, board)


def test_poses_of_the_wrong_frames_and_a_slipped_board_are_refused() -> None:
    tools, boards = samples()
    slipped = boards.copy()
    slipped[8:, :3, 3] += 0.03
    for wrong in (inverse(boards), slipped):
        with refused(ErrorCode.CALIBRATION_DATA, "do not agree"):
            calibrate(tools, wrong).check()


def test_a_camera_that_one_sample_moves_is_refused_and_the_worst_sample_named() -> None:
    result, turned = calibrate(*samples()), np.zeros(15)
    turned[3] = 0.1
    for change, words in (
        ({"spread": 0.006}, "leaving one sample out moves the camera by 6.0 mm"),
        ({"residual_angles": turned}, "the worst is sample 3 "),
    ):
        with refused(ErrorCode.CALIBRATION_DATA, words):
            replace(result, **change).check()


def pose(T: np.ndarray) -> dict[str, list[float]]:
    position, quaternion = to_quaternion(T)
    return {"position": position.tolist(), "quaternion_xyzw": quaternion.tolist()}


def written(path: Path, tools: np.ndarray, boards: np.ndarray) -> Path:
    entries = [
        {"T_base_tool0": pose(t), "T_camera_board": pose(b)} for t, b in zip(tools, boards, strict=True)
    ]
    path.write_text(yaml.safe_dump({"samples": entries}))
    return path


def test_command_writes_the_camera_into_the_cell(tmp_path: Path) -> None:
    file, out = written(tmp_path / "samples.yaml", *samples()), tmp_path / "cell.yaml"
    figures = tmp_path / "new" / "figures.json"
    ended = CliRunner().invoke(app, [str(file), "--out", str(out), "--json", str(figures)])
    assert ended.exit_code == 0
    assert error(load_cell(out).T_base_camera_optical) == pytest.approx((0, 0), abs=1e-6)
    assert "leave_one_out_m" in ended.stdout and figures.exists()
    noisy = written(tmp_path / "noisy.yaml", *samples(20, 0, position_noise=0.001))
    assert CliRunner().invoke(app, [str(noisy), "--out", str(out)]).exit_code == 0
    for option in ("--max-residual", "--max-spread"):
        for limit in ("1e-4", "nan"):
            assert CliRunner().invoke(app, [str(noisy), "--out", str(out), option, limit]).exit_code == 1


def test_command_refuses_in_one_sentence_and_writes_nothing(tmp_path: Path) -> None:
    tools, boards = samples()
    boards[8:, :3, 3] += 0.03
    out = tmp_path / "cell.yaml"
    ended = CliRunner().invoke(
        app, [str(written(tmp_path / "samples.yaml", tools, boards)), "--out", str(out)]
    )
    assert ended.exit_code == 1 and not out.exists()
    assert str(int(ErrorCode.CALIBRATION_DATA)) in ended.stderr
    no_cell = CliRunner().invoke(app, [str(tmp_path / "samples.yaml"), "--out", ""])
    assert no_cell.exit_code == 2 and "is DGS_CELL set?" in no_cell.stderr
    good = written(tmp_path / "good.yaml", *samples())
    no_file = CliRunner().invoke(app, [str(good), "--out", str(out), "--json", str(tmp_path)])
    assert no_file.exit_code == 2 and "is a directory" in no_file.stderr and not out.exists()
    below_a_file = good / "figures.json"
    no_place = CliRunner().invoke(app, [str(good), "--out", str(out), "--json", str(below_a_file)])
    assert no_place.exit_code == 1 and "figures.json cannot be written" in no_place.stderr
    assert not out.exists()


def test_samples_with_images_of_the_board(tmp_path: Path) -> None:
    file, truth = tmp_path / "samples.yaml", from_rpy((-0.05, -0.04, 0.5), (0.5, 0.0, 0.3))
    cv2.imwrite(str(tmp_path / "seen.png"), picture(truth))
    camera = {key: getattr(CAMERA, key) for key in ("fx", "fy", "cx", "cy")}
    content = {"board": asdict(BOARD), "camera": camera}
    sample = {"T_base_tool0": pose(np.eye(4)), "image": "seen.png"}
    file.write_text(yaml.safe_dump(content | {"samples": [sample]}))
    np.testing.assert_allclose(read_samples(file)[1][0], truth, atol=0.005)
    camera["distortion"] = [0.1, 0.0, 0.0]
    for image, words in (
        ("seen.png", "sample 0 of .*: 3 coefficients"),
        ("none.png", "sample 0 of .*: .*none.png is no image"),
    ):
        file.write_text(yaml.safe_dump(content | {"samples": [sample | {"image": image}]}))
        with refused(ErrorCode.CALIBRATION_DATA, words):
            read_samples(file)
    file.write_text(yaml.safe_dump({"samples": [sample]}))
    with refused(ErrorCode.CALIBRATION_DATA, "sample 0 of .*: an image needs `board` and `camera`"):
        read_samples(file)


RIGHT = "{position: [0, 0, 0], quaternion_xyzw: [0, 0, 0, 1]}"


@pytest.mark.parametrize(
    ("samples", "words"),
    [
        ("", "no file of samples"),
        ("3", "no file of samples"),
        ("[]", "no file of samples"),
        (f"[{{T_base_tool0: {RIGHT}}}]", "sample 0 .*T_camera_board"),
        *(
            (
                f"[{{T_base_tool0: {RIGHT}, T_camera_board: {wrong}}}]",
                f"sample 0 of .*: T_camera_board has {words}",
            )
            for wrong, words in (
                ("{position: [0, 0], quaternion_xyzw: [0, 0, 0, 1]}", r"position \[0, 0\]"),
                ("{position: [0, 0, .nan], quaternion_xyzw: [0, 0, 0, 1]}", r"position \[0, 0, nan\]"),
                ("{position: [0, 0, up], quaternion_xyzw: [0, 0, 0, 1]}", "position .*'up'"),
                ("{position: [0, 0, 0], quaternion_xyzw: [0, 0, 0, 2]}", "a quaternion of norm 2"),
            )
        ),
    ],
)
def test_files_that_are_no_samples(tmp_path: Path, samples: str, words: str) -> None:
    (tmp_path / "samples.yaml").write_text(samples and f"samples: {samples}")
    with refused(ErrorCode.CALIBRATION_DATA, words):
        read_samples(tmp_path / "samples.yaml")
