"""`dgs predict` from files to JSON and picture: all kinds of input, all kinds of bad input."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh
from typer.testing import Result

from dgs_description.cell import CELL
from dgs_description.frames import apply, from_quaternion, inverse
from dgs_description.hand import HAND
from dgs_learning.prediction.cloud_file import read_cloud, read_intrinsics
from dgs_sim_bridge.render.d455 import D455
from tests.dgs_grasp_planner.models import save_eager_model
from tests.dgs_learning.test_bad_frames import SPOTS, cell_shot
from tests.support.commands import dgs

INTRINSICS = f"{D455.fx},{D455.fy},{D455.cx},{D455.cy}"
Predict = Callable[..., Result]


@pytest.fixture(scope="module")
def depth() -> np.ndarray:
    """(H, W) float32 [m]: the cell's table with a thing on each of `SPOTS`, through the nominal camera."""
    return cell_shot(0, objects=len(SPOTS))


@pytest.fixture(scope="module")
def cloud(depth: np.ndarray) -> np.ndarray:
    return D455.deproject(depth)


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("models")
    save_eager_model(folder, "tiny")
    return folder


@pytest.fixture
def predict(models: Path) -> Predict:
    def run(*arguments: object, code: int = 0) -> Result:
        words = ["predict", *map(str, arguments), "--models-dir", str(models)]
        return dgs([*words, "--model", "tiny", "--threads", "1"], code)

    return run


@pytest.fixture(scope="module")
def depth_png(depth: np.ndarray, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("depth") / "depth.png"
    cv2.imwrite(str(path), np.round(depth * 1000).astype(np.uint16))
    return path


def _positions(answer: dict) -> np.ndarray:
    return np.array([grasp["tcp_pose"]["position"] for grasp in answer["grasps"]])


def test_a_depth_image_gives_grasps_above_the_estimated_table(
    predict: Predict, depth_png: Path, tmp_path: Path
) -> None:
    out, picture = tmp_path / "a" / "grasps.json", tmp_path / "b" / "grasps.png"
    result = predict(
        depth_png, "--intrinsics", INTRINSICS, "--json", out, "--picture", picture, "--max-grasps", 5
    )
    answer = json.loads(out.read_text())
    assert answer["error_code"] == 0 and answer["frame"] == "camera_depth_optical_frame"
    assert answer["tcp_frame"] == "hand_tcp" and answer["table"]["estimated"]
    assert 0 < len(answer["grasps"]) <= 5
    grasp = answer["grasps"][0]
    assert list(grasp["grasp_joints"]) == list(grasp["pre_grasp_joints"]) == list(HAND.joints)
    pose = answer["table"]["pose"]
    T_table_camera = inverse(from_quaternion(pose["position"], pose["quaternion_xyzw"]))
    height = CELL.T_base_camera_optical[2, 3] - CELL.table_height
    assert T_table_camera[2, 3] == pytest.approx(height, abs=3e-3) == answer["table"]["camera_height"]
    heights = apply(T_table_camera, _positions(answer))[:, 2]
    assert ((heights > 0.0) & (heights < 0.35)).all()
    image = cv2.imread(str(picture))
    assert image.shape == (720, 1280, 3)
    assert (image < 200).any(axis=2).mean() > 0.1, "the cloud is in the picture"
    assert re.search(r"\d grasps? in camera_depth_optical_frame", result.output)


def test_the_cell_gives_the_same_hands_in_base_link(
    depth_png: Path, cloud: np.ndarray, tmp_path: Path
) -> None:
    """With the shipped weights: what an untrained network likes best depends on the last digit."""

    out = tmp_path / "out.json"

    def predict(*words: object) -> dict:
        dgs(["predict", *map(str, words), "--threads", "1", "--json", str(out)])
        return json.loads(out.read_text())

    answer = predict(depth_png, "--intrinsics", INTRINSICS, "--in-cell")
    assert answer["frame"] == "base_link" and not answer["table"]["estimated"]
    low, high = CELL.workspace_bounds
    points = np.array([grasp["reference_point"] for grasp in answer["grasps"]])
    assert ((points > low - 0.05) & (points < high + 0.05)).all()
    np.save(tmp_path / "base.npy", apply(CELL.T_base_camera_optical, cloud.astype(float)))
    again = predict(tmp_path / "base.npy", "--cloud-frame", "base_link")
    near = np.linalg.norm(_positions(again)[:, None] - _positions(answer)[None], axis=2).min(axis=1)
    assert len(near) > 5 and np.median(near) < 0.02, "the PNG's millimetres change little"


def test_flying_pixels_are_taken_out_on_demand(depth_png: Path) -> None:
    raw, clean = (read_cloud(depth_png, INTRINSICS, edges=edges) for edges in (False, True))
    assert 0.9 * len(raw.points) < len(clean.points) < len(raw.points)


def test_a_mask_says_what_may_be_grasped(
    predict: Predict, depth: np.ndarray, depth_png: Path, tmp_path: Path
) -> None:
    out, middle = tmp_path / "out.json", SPOTS[5]
    base = apply(CELL.T_base_camera_optical, D455.all_points(depth).astype(float))
    marked = np.linalg.norm(base[:, :2] - middle, axis=1) < 0.07
    cv2.imwrite(str(tmp_path / "mask.png"), (255 * marked.reshape(depth.shape)).astype(np.uint8))
    words = (depth_png, "--intrinsics", INTRINSICS, "--mask", tmp_path / "mask.png", "--json", out)
    predict(*words, "--min-score", 0.0)
    points = np.array([grasp["reference_point"] for grasp in json.loads(out.read_text())["grasps"]])
    there = apply(CELL.T_base_camera_optical, points)
    assert np.linalg.norm(there[:, :2] - middle, axis=1).max() < 0.10


@pytest.mark.parametrize("kind", ["black", "small", "text"])
def test_a_bad_mask_is_refused(predict: Predict, depth_png: Path, tmp_path: Path, kind: str) -> None:
    mask = tmp_path / "mask.png"
    if kind == "text":
        mask.write_text("no image")
    else:
        size = (10, 10) if kind == "small" else (D455.height, D455.width)
        cv2.imwrite(str(mask), np.full(size, 0 if kind == "black" else 255, np.uint8))
    result = predict(depth_png, "--intrinsics", INTRINSICS, "--mask", mask, code=2)
    assert result.stderr.startswith("error 107 REQUEST_INVALID: the mask")


def test_a_mask_of_the_bare_table_is_refused(
    predict: Predict, depth: np.ndarray, depth_png: Path, tmp_path: Path
) -> None:
    mask = np.zeros(depth.shape, np.uint8)
    mask[5:40, 300:400] = 255
    cv2.imwrite(str(tmp_path / "mask.png"), mask)
    result = predict(depth_png, "--intrinsics", INTRINSICS, "--mask", tmp_path / "mask.png", code=2)
    assert "105 NO_OBJECTS: the mask marks nothing" in result.stderr


def test_the_same_seed_gives_the_same_json_from_every_kind_of_file(
    predict: Predict, cloud: np.ndarray, tmp_path: Path
) -> None:
    np.save(tmp_path / "cloud.npy", cloud)
    np.savez(tmp_path / "cloud.npz", points=cloud, note=np.array(1))
    trimesh.PointCloud(cloud, colors=np.full((len(cloud), 3), 90, np.uint8)).export(tmp_path / "cloud.ply")
    answers = []
    for name in ("cloud.npy", "cloud.npz", "cloud.ply"):
        out = tmp_path / f"{name}.json"
        predict(tmp_path / name, "--seed", 3, "--json", out)
        answer = json.loads(out.read_text())
        assert answer.pop("input") == {"file": name, "points": len(cloud)}
        answers.append({key: value for key, value in answer.items() if key != "stage_times"})
    assert answers[0] == answers[1] == answers[2]
    assert answers[0]["seed"] == 3


def test_colours_of_a_ply_are_those_of_the_picture(
    predict: Predict, cloud: np.ndarray, tmp_path: Path
) -> None:
    trimesh.PointCloud(cloud, colors=np.tile(np.uint8([200, 30, 30]), (len(cloud), 1))).export(
        tmp_path / "c.ply"
    )
    predict(tmp_path / "c.ply", "--picture", tmp_path / "p.png", "--max-grasps", 1)
    blue, green, red = cv2.imread(str(tmp_path / "p.png")).astype(int).transpose(2, 0, 1)
    assert ((red > 150) & (green < 80) & (blue < 80)).mean() > 0.1


def test_no_grasp_is_told_with_its_code(predict: Predict, cloud: np.ndarray, tmp_path: Path) -> None:
    """Pushes, which the planner proposes here, are no grasps."""
    np.save(tmp_path / "cloud.npy", cloud)
    out, words = tmp_path / "out.json", ("--min-score", 1.0, "--picture", tmp_path / "p.png")
    predict(tmp_path / "cloud.npy", *words, "--json", out, code=1)
    answer = json.loads(out.read_text())
    assert answer["error_code"] == 106 and answer["grasps"] == [] and "min_score" in answer["message"]
    assert (tmp_path / "p.png").exists()


def _write_bad(kind: str, folder: Path, cloud: np.ndarray) -> Path:
    """A file of a name; those of other names than below are not there."""
    path, kind_of = folder / kind, kind.partition(".")[0]
    x, y = np.meshgrid(np.linspace(-0.4, 0.4, 200), np.linspace(-0.4, 0.4, 200))
    arrays = {
        "pickle": np.array([{"a": 1}], dtype=object),
        "flat": np.zeros(30),
        "empty": np.zeros((0, 3)),
        "nan": np.full((500, 3), np.nan),
        "millimetres": cloud * 1000,
        "fog": np.random.default_rng(0).uniform((-0.4, -0.4, 0.5), (0.4, 0.4, 1.3), (30_000, 3)),
        "table": np.column_stack([x.ravel(), y.ravel(), np.ones(x.size)]),
    }
    images = {"colour": np.zeros((48, 64, 3), np.uint8), "black": np.zeros((480, 848), np.uint16)}
    if kind_of in arrays:
        np.save(path, arrays[kind_of], allow_pickle=True)
    elif kind_of in images:
        cv2.imwrite(str(path), images[kind_of])
    elif kind_of == "text":
        path.write_text("no cloud")
    elif kind_of == "two":
        np.savez(path, a=cloud, b=cloud)
    return path


@pytest.mark.parametrize(
    ("kind", "options", "code"),
    [
        ("nothing.npy", (), "103 CLOUD_FORMAT"),
        ("cloud.bag", (), "103 CLOUD_FORMAT"),
        ("text.ply", (), "103 CLOUD_FORMAT"),
        ("text.npy", (), "103 CLOUD_FORMAT"),
        ("pickle.npy", (), "103 CLOUD_FORMAT"),
        ("flat.npy", (), "103 CLOUD_FORMAT"),
        ("two.npz", (), "103 CLOUD_FORMAT"),
        ("empty.npy", (), "100 CLOUD_EMPTY"),
        ("millimetres.npy", (), "100 CLOUD_EMPTY"),
        ("nan.npy", (), "101 CLOUD_NOT_FINITE"),
        ("fog.npy", (), "114 CLOUD_NO_TABLE"),
        ("table.npy", (), "105 NO_OBJECTS"),
        ("table.npy", ("--intrinsics", INTRINSICS), "404 CAMERA_INFO_INVALID"),
        ("table.npy", ("--in-cell",), "114 CLOUD_NO_TABLE"),
        ("table.npy", ("--cloud-frame", "base_link"), "114 CLOUD_NO_TABLE"),
        ("colour.png", ("--intrinsics", INTRINSICS), "405 DEPTH_FORMAT"),
        ("black.png", ("--intrinsics", INTRINSICS), "100 CLOUD_EMPTY"),
        ("black.png", (), "404 CAMERA_INFO_INVALID"),
        ("black.png", ("--intrinsics", "1,2,3"), "404 CAMERA_INFO_INVALID"),
        ("black.png", ("--intrinsics", "-5,447,424,240"), "404 CAMERA_INFO_INVALID"),
        ("black.png", ("--intrinsics", "missing.yaml"), "404 CAMERA_INFO_INVALID"),
    ],
)
def test_bad_input_gets_code_and_sentence(
    predict: Predict, cloud: np.ndarray, tmp_path: Path, kind: str, options: tuple[str, ...], code: str
) -> None:
    result = predict(_write_bad(kind, tmp_path, cloud), *options, code=2)
    (line,) = result.stderr.strip().splitlines()
    assert line.startswith(f"error {code}: ") and len(line) > len(code) + 25
    assert not list(tmp_path.glob("*.json"))


def test_missing_weights_are_refused(tmp_path: Path, cloud: np.ndarray) -> None:
    np.save(tmp_path / "cloud.npy", cloud)
    words = ["predict", str(tmp_path / "cloud.npy"), "--models-dir", str(tmp_path)]
    assert "108 WEIGHTS_MISSING" in dgs(words, 2).stderr


@pytest.mark.parametrize(
    "content",
    [
        "fx: {fx}\nfy: {fy}\ncx: {cx}\ncy: {cy}\nwidth: 848\nheight: 480\n",
        "k: [{fx}, 0, {cx}, 0, {fy}, {cy}, 0, 0, 1]\n",
        "camera_matrix:\n  rows: 3\n  data: [{fx}, 0, {cx}, 0, {fy}, {cy}, 0, 0, 1]\n",
        "layout_version 1\nwidth 848\nheight 480\nfx {fx}\nfy {fy}\ncx {cx}\ncy {cy}\ndepth_unit 0.001\n",
    ],
)
def test_intrinsics_from_files(tmp_path: Path, content: str) -> None:
    file = tmp_path / "camera.yaml"
    file.write_text(content.format(fx=D455.fx, fy=D455.fy, cx=D455.cx, cy=D455.cy))
    found = read_intrinsics(str(file), D455.width, D455.height)
    assert (found.fx, found.fy, found.cx, found.cy) == (D455.fx, D455.fy, D455.cx, D455.cy)
