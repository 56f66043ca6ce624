"""Two hundred frames as broken cameras, drivers and mounts make them: each is refused with a code and what to do.

Every frame goes the way of `dgs predict` (the table is estimated) or of the nodes (the camera's pose is known), up to
where the planner would propose grasps: no frame may come so far.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dgs_description.cell import CELL
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import Array, look_at, transform
from dgs_grasp_planner.cell_planner import in_workspace, predict_on_table
from dgs_grasp_planner.preprocess import check_points
from dgs_grasp_planner.scene import PlanRequest, Prediction, prepare
from dgs_learning.prediction.offline import answer_on_estimated_table
from dgs_perception.edges import clean_points
from dgs_perception.pipeline import CloudPipeline
from dgs_sim_bridge.render.d455 import D455, D455Noise
from dgs_sim_bridge.render.object_model import find_catalogue
from dgs_sim_bridge.render.raster import box_mesh, render

CATALOGUE = find_catalogue("novel")
OPTICAL = "camera_depth_optical_frame"
REFUSALS = (
    ErrorCode.CLOUD_EMPTY,
    ErrorCode.CLOUD_NOT_FINITE,
    ErrorCode.CLOUD_FORMAT,
    ErrorCode.CLOUD_NO_TABLE,
    ErrorCode.NO_OBJECTS,
    ErrorCode.CAMERA_INFO_INVALID,
    ErrorCode.DEPTH_FORMAT,
)
ADVICE = (":", "?", "must", "needed")
SPOTS = [(x, y) for x in (0.2, 0.32) for y in (-0.25, -0.08, 0.08, 0.25)]
"""Of the things on the cell's table, in `base_link` [m]; `cell_shot` of eight shows one on each."""
FLOOR = box_mesh((-3.0, -3.0, -0.82), (3.0, 3.0, -0.8))


def _planner(cloud: np.ndarray, camera: Array, rng: np.random.Generator, request: PlanRequest) -> Prediction:
    scene = prepare(cloud, camera, rng, request)
    raise AssertionError(f"{len(scene.points)} points would be grasped")


def cell_shot(seed: int, objects: int = 5, table: bool = True, pose: Array | None = None) -> np.ndarray:
    """(H, W) float32 [m]: the cell's table with things, through a pose (4, 4) in `base_link`, with noise."""
    rng = np.random.default_rng(seed)
    (x, y), (sx, sy, thick), top = CELL.table_centre, CELL.table_size, CELL.table_height
    meshes, poses = [], []
    if table:
        meshes.append(box_mesh((x - sx / 2, y - sy / 2, top - thick), (x + sx / 2, y + sy / 2, top)))
        poses.append(np.eye(4))
    for k in rng.permutation(len(SPOTS))[:objects]:
        model = CATALOGUE[int(rng.integers(len(CATALOGUE)))]
        meshes.append(model.mesh)
        poses.append(transform(position=(*SPOTS[k], top - model.vertices[:, 2].min())))
    ideal = render(meshes, poses, D455, CELL.T_base_camera_optical if pose is None else pose).depth
    return D455Noise().apply(ideal, D455, rng)


@cache
def _usual(seed: int) -> np.ndarray:
    return cell_shot(seed)


def _steps(depth: np.ndarray, unit: float = 0.001) -> np.ndarray:
    """16 bits in steps of `unit`, as a driver writes them."""
    return np.rint(depth / unit).astype(np.int64).astype(np.uint16)


def _random(seed: int) -> np.random.Generator:
    return np.random.default_rng([seed, 9])


def _room(seed: int) -> np.ndarray:
    """A wall and a floor, nothing else."""
    wall = box_mesh((-1.2, -3.0, -0.8), (-1.1, 3.0, 2.0))
    eye = (0.9, 0.1 * seed, 0.4)
    ideal = render([wall, FLOOR], [np.eye(4)] * 2, D455, look_at(eye, (-1.1, 0.0, 0.1))).depth
    return D455Noise().apply(ideal, D455, _random(seed))


def _ball(seed: int) -> np.ndarray:
    v, u = np.mgrid[: D455.height, : D455.width]
    away = np.hypot(u - D455.cx, v - D455.cy) / D455.fx
    radius = 0.25 + 0.05 * seed
    z = 1.0 - np.sqrt(np.clip(radius**2 - away**2, 0.0, None))
    return np.where(away < 0.95 * radius, z, 0.0).astype(np.float32)


def _waves(seed: int) -> np.ndarray:
    u = np.arange(D455.width) / D455.width
    z = 1.0 + 0.08 * np.sin(2 * np.pi * (4 + seed) * u)
    return np.tile(z.astype(np.float32), (D455.height, 1))


ANYWHERE: dict[str, Callable[[int], np.ndarray]] = {
    "all zero": lambda s: np.zeros((480, 848), np.uint16),
    "saturated": lambda s: np.full((480, 848), 65535 - s, np.uint16),
    "speckle": lambda s: np.where(
        _random(s).random((480, 848)) < 0.001 * (s + 1), _steps(_usual(s)), 0
    ).astype(np.uint16),
    "fog": lambda s: _random(s).uniform(0.4, 1.0 + 0.1 * s, (480, 848)).astype(np.float32),
    "fog of few points": lambda s: np.where(
        _random(s).random((480, 848)) < 0.05, _random(s + 50).uniform(0.5, 1.2, (480, 848)), 0.0
    ).astype(np.float32),
    "lens covered": lambda s: (20 + _random(s).integers(0, 10, (480, 848))).astype(np.uint16),
    "whole metres": lambda s: np.rint(_usual(s)).astype(np.uint16),
    "millimetres as metres": lambda s: (1000.0 * _usual(s)).astype(np.float32),
    "metres as millimetres": lambda s: (0.001 * _usual(s)).astype(np.float32),
    "tenths of a millimetre": lambda s: _steps(_usual(s), 1e-4),
    "16-bit overflow": lambda s: _steps(_usual(s), 1e-5),
    "bytes swapped": lambda s: _steps(_usual(s)).byteswap(),
    "low byte only": lambda s: _steps(_usual(s)) & np.uint16(255),
    "high byte only": lambda s: _steps(_usual(s)) >> np.uint16(8),
    "disparity for depth": lambda s: np.where(_usual(s) > 0, 42.5 / np.maximum(_usual(s), 0.1), 0).astype(
        np.uint16
    ),
    "not a number": lambda s: np.full((480, 848), np.nan, np.float32),
    "infinite": lambda s: np.full((480, 848), np.inf, np.float32),
    "negative": lambda s: -_usual(s),
    "wrong size": lambda s: np.ones((240, 424 + s), np.uint16),
    "three channels": lambda s: np.ones((480, 848, 3), np.uint16),
    "eight bits": lambda s: np.full((480, 848), 100 + s, np.uint8),
    "no table, no things": lambda s: cell_shot(s, objects=0, table=False),
    "empty table": lambda s: cell_shot(s, objects=0),
    "room": _room,
    "ball": _ball,
    "waves": _waves,
}
"""Refused whether the camera's pose is known or not."""


def _moved(
    shift: tuple[float, float, float], turn: tuple[float, float, float]
) -> Callable[[int], np.ndarray]:
    """The camera stands elsewhere than its extrinsics say, by up to twice as much with growing seed [m, deg]."""

    def shot(seed: int) -> np.ndarray:
        pose, grow = CELL.T_base_camera_optical.copy(), 1.0 + seed / 4
        pose[:3, :3] @= Rotation.from_euler("xyz", grow * np.array(turn), degrees=True).as_matrix()
        pose[:3, 3] += grow * np.array(shift)
        return cell_shot(seed, pose=pose)

    return shot


IN_THE_CELL: dict[str, Callable[[int], np.ndarray]] = {
    "upside down": lambda s: _usual(s)[::-1, ::-1].copy(),
    "mirrored top to bottom": lambda s: _usual(s)[::-1].copy(),
    "camera 8 cm lower": _moved((0.0, 0.0, -0.08), (0.0, 0.0, 0.0)),
    "camera 8 cm higher": _moved((0.0, 0.0, 0.08), (0.0, 0.0, 0.0)),
    "camera tilted": _moved((0.0, 0.0, 0.0), (-12.0, 0.0, 0.0)),
    "camera rolled": _moved((0.0, 0.0, 0.0), (0.0, 0.0, 45.0)),
}
"""Refused where the camera's pose is said to be that of the cell."""


def _refused(run: Callable[[], object]) -> None:
    with pytest.raises(DgsError) as error:
        run()
    assert error.value.code in REFUSALS, error.value
    assert len(error.value.message) > 40 and any(word in error.value.message for word in ADVICE), (
        error.value.message
    )


def _predict(depth: np.ndarray) -> object:
    points = D455.all_points(depth)
    clean_points(points, D455)
    measured = np.isfinite(points).all(axis=1) & (points != 0).any(axis=1)
    return answer_on_estimated_table(_planner, points[measured], 0, PlanRequest())


def _in_cell(depth: np.ndarray) -> object:
    pipeline = CloudPipeline(edges=True)
    points, _ = pipeline.from_depth(depth, D455, OPTICAL)
    seen = check_points(points, skip_invalid=True)
    inside = seen[in_workspace(seen)].astype(float)
    return predict_on_table(
        _planner, inside, CELL.T_base_camera_optical[:3, 3], CELL.T_base_table, 0, PlanRequest()
    )


def test_a_good_frame_comes_through() -> None:
    for way in (_predict, _in_cell):
        with pytest.raises(AssertionError, match="points would be grasped"):
            way(_steps(_usual(0)))


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("kind", ANYWHERE)
def test_refused_where_the_table_is_estimated(kind: str, seed: int) -> None:
    _refused(lambda: _predict(ANYWHERE[kind](seed)))


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("kind", [*ANYWHERE, *IN_THE_CELL])
def test_refused_where_the_pose_is_known(kind: str, seed: int) -> None:
    _refused(lambda: _in_cell((ANYWHERE | IN_THE_CELL)[kind](seed)))
