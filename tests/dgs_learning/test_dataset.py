"""The dataset: through its file, into scenes, without some of its grasps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray

from dgs_description.arrays import load_arrays, save_arrays
from dgs_description.errors import DgsError
from dgs_description.hand import HAND
from dgs_learning.dataset import FARTHEST, LEVER, GraspDataset, load_dataset, save_dataset, steadiness
from tests.dgs_learning.small_dataset import small_dataset
from tests.dgs_learning.tiny_dataset import tiny_dataset


@pytest.fixture(scope="module")
def dataset() -> GraspDataset:
    return tiny_dataset()


def test_dropped_grasps_are_gone_from_objects_and_scenes_and_the_rest_is_as_before() -> None:
    data = small_dataset()
    scene = next(s for s in data.scenes if len(s.grasp) > 2)
    lost = int(data.first[scene.objects[scene.instance[1]]] + scene.grasp[1])
    less = data.without([lost])
    assert np.array_equal(less.grasps.position, np.delete(data.grasps.position, lost, 0))
    assert less.first[-1] == len(less.grasps) == len(data.grasps) - 1
    for before, after in zip(data.scenes, less.scenes, strict=True):
        rows = data.first[before.objects[before.instance]] + before.grasp
        stays = rows != lost
        assert np.allclose(less.scene_grasps(after).position, data.scene_grasps(before).position[stays])
        assert np.array_equal(
            less.scene_grasps(after).grasp_joints, data.scene_grasps(before).grasp_joints[stays]
        )


def test_of_a_thinned_dataset_every_object_has_so_many_grasps_at_most() -> None:
    data = small_dataset()
    thin, other = data.thinned(3, 0), data.thinned(3, 1)
    assert (
        np.array_equal(np.diff(thin.first), np.minimum(np.diff(data.first), 3))
        and thin.first[-1] < data.first[-1]
    )
    stored = {tuple(position) for position in data.grasps.position}
    assert all(tuple(position) in stored for position in thin.grasps.position)
    assert not np.array_equal(thin.grasps.position, other.grasps.position)
    left = sum(len(scene.grasp) for scene in thin.scenes)
    assert 0 < left < sum(len(scene.grasp) for scene in data.scenes)
    assert max(scene.grasp.max(initial=0) for scene in thin.scenes) < 3


def test_dataset_survives_the_file(dataset: GraspDataset, tmp_path: Path):
    position = dataset.grasps.position.copy()
    position[0] = (FARTHEST, -FARTHEST, 0.0)
    joints, gap = dataset.grasps.grasp_joints.copy(), dataset.gap.copy()
    joints[0], joints[1], gap[0, 0] = HAND.lower, HAND.upper, 0.0254  # as far as the file goes
    whole = replace(dataset, grasps=replace(dataset.grasps, position=position, grasp_joints=joints), gap=gap)
    joints = joints + [[-0.02], [0.02], [0.0], [0.0]]
    beyond = replace(whole.grasps, grasp_joints=joints)
    dataset = replace(whole, grasps=beyond, gap=np.where(gap == 0.0254, 0.04, gap))
    save_dataset(tmp_path / "d.npz", dataset)
    read = load_dataset(tmp_path / "d.npz")
    dataset = whole
    assert np.abs(read.grasps.position - dataset.grasps.position).max() < 1e-5
    assert np.abs(read.grasps.rotation - dataset.grasps.rotation).max() < 1e-4
    assert np.abs(read.grasps.grasp_joints - dataset.grasps.grasp_joints).max() < 0.004
    assert np.array_equal(read.grasps.source, dataset.grasps.source)
    assert np.allclose(read.gap, dataset.gap, equal_nan=True)
    assert np.allclose(read.friction, dataset.friction, equal_nan=True)
    assert np.array_equal(read.scenes[2].symmetry, dataset.scenes[2].symmetry)
    assert np.allclose(read.scenes[1].T_table_object, dataset.scenes[1].T_table_object, atol=1e-4)


def test_a_dataset_without_scenes_has_none_after_the_file(dataset: GraspDataset, tmp_path: Path) -> None:
    save_dataset(tmp_path / "d.npz", replace(dataset, scenes=[]))
    assert load_dataset(tmp_path / "d.npz").scenes == []


def test_of_a_file_without_gaps_nobody_knows_which_fingers_touch(
    dataset: GraspDataset, tmp_path: Path
) -> None:
    assert dataset.in_air.tolist()[0] == [False, False, False, False, True] and dataset.in_air.sum() == 1
    path = tmp_path / "d.npz"
    save_dataset(path, dataset)
    arrays = load_arrays(path)
    del arrays["grasp_gap"]
    save_arrays(path, arrays)
    read = load_dataset(path)
    assert np.isnan(read.gap).all() and not read.in_air.any()


@pytest.mark.parametrize("version", [1, 3])
def test_other_versions_are_refused(dataset: GraspDataset, tmp_path: Path, version: int) -> None:
    path = tmp_path / "d.npz"
    save_dataset(path, dataset)
    save_arrays(path, load_arrays(path) | {"version": version})
    with pytest.raises(DgsError, match=f"version {version}"):
        load_dataset(path)


@pytest.mark.parametrize(
    ("array", "change"),
    [
        ("version", lambda version: [version, version]),
        ("first", lambda first: first[:-1]),
        ("first", lambda first: first[::-1]),
        ("grasp_friction", lambda friction: friction[1:]),
        ("trials", lambda trials: trials[1:]),
        ("scene_instance", lambda instance: instance[1:]),
        ("scene_grasp", lambda grasp: grasp + 100),
        ("scene_objects", lambda objects: objects + 100),
    ],
)
def test_tables_that_do_not_belong_together_are_refused(
    dataset: GraspDataset, tmp_path: Path, array: str, change: Callable[[NDArray], ArrayLike]
) -> None:
    path = tmp_path / "d.npz"
    save_dataset(path, dataset)
    arrays = load_arrays(path)
    save_arrays(path, arrays | {array: change(arrays[array])})
    with pytest.raises(DgsError, match=r"d\.npz cannot be read"):
        load_dataset(path)


def test_scene_grasps_turn_with_object_and_symmetry(dataset: GraspDataset):
    grasps = dataset.scene_grasps(dataset.scenes[0])
    assert np.allclose(grasps.position[0], dataset.grasps.position[0] + [-0.1, 0, 0.04])
    mirrored = np.diag([1.0, -1.0, -1.0])
    assert np.allclose(grasps.position[1], mirrored @ dataset.grasps.position[1] + [-0.1, 0, 0.04])
    assert np.array_equal(grasps.active_fingers[1], [True, True, True, False, False])


def test_little_friction_and_a_short_lever_make_a_grasp_steady(dataset: GraspDataset) -> None:
    worth = steadiness([0.3, 0.4, 0.5, np.nan, 0.3, 0.3], [0.0, 0.0, 0.0, 0.0, LEVER, 1.0])
    assert np.allclose(worth, [1.0, 2 / 3, 1 / 3, 1 / 3, np.exp(-1), 0.01])
    scene = dataset.scenes[0]
    grasps = dataset.scene_grasps(scene)
    beside = (grasps.position - scene.T_table_object[scene.instance, :3, 3])[:, :2]
    lever = np.linalg.norm(beside, axis=1)
    assert np.allclose(grasps.score, steadiness(dataset.friction[dataset.rows(scene)], lever))
